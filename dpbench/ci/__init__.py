"""Continuous integration of a solver: replays under pytest-benchmark, compared with a baseline."""

MARGIN = 0.15
"""By how much a benchmark may be slower without a verdict."""
