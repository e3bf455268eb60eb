"""Solvers against the demand of a suite: who meets it, who is fastest, which one to use."""
