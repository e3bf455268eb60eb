"""Judgement of runs: rules of counting, columns of steps, rows of runs."""
