"""Verdicts in words: reasons, late times, custom settings, tolerances."""
