"""What the recipes of dpbench's own solvers generate."""
