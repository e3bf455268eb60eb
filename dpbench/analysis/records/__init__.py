"""Rows of the tables as typed records, and queries on them: runs, steps, step times."""
