"""Estimators of the ship's state, from its measurement."""
