"""Solvers against the requirements of a suite: verdicts, the fastest, and the one to use."""
