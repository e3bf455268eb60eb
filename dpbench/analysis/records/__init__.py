"""Rows of the tables as typed records, and what is asked of them: runs, steps, step times."""
