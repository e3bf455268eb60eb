"""Verdicts in words: reasons, late times, tolerances left at a default."""
