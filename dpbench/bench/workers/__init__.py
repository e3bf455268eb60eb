"""Processes that run cells, side by side or interleaved."""
