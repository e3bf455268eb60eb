"""Suites, and the cells they mean."""
