"""Certificates of infeasibility, rounding of limits, forced and implied equalities."""
