"""Generator of the C that the recipe of QOCO compiles."""
