"""The search for a solver's worst step."""
