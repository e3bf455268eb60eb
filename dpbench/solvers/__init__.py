"""Solvers: the contract, the table, the tolerance levels and one adapter per library."""
