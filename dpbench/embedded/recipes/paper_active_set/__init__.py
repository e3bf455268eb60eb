"""Generator of the headers that the recipes of dpbench's own solvers compile."""
