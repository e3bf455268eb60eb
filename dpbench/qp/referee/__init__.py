"""Certified optima, proofs that there is none, and whether a claim is true."""
