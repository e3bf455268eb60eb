"""Processes that run cells, side by side or timed by turns."""
