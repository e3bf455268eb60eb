"""What the recipe of OSQP generates."""
