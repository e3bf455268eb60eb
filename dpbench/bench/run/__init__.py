"""Runs of one solver in one process: closed loop, replay, and the timed solver."""
