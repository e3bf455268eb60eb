"""Search for a solver's worst step."""
