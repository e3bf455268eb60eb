"""Continuous integration of a solver: replays under pytest-benchmark, compared with a baseline."""

MARGIN = 0.15
"""Largest slow-down of a benchmark that is no verdict, as a share of its time."""
