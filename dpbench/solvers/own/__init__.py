"""Solvers that are this project's own code."""
