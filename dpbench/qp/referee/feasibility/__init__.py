"""What limits leave: nothing, a point by rounding only, no freedom, no need."""
