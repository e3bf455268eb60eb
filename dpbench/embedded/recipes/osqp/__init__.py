"""Generator of the C that the recipe of OSQP compiles."""
