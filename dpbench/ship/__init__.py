"""The ship: vessel data, environment, nonlinear 3-DOF plant (paper section II)."""
