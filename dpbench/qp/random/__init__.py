"""Random QPs with a planted optimum."""
