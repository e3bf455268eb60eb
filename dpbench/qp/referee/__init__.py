"""Certified optima, proofs that there is none, and tests of claims."""
