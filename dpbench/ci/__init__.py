"""Continuous integration of a solver: replays under pytest-benchmark, compared with a baseline."""
