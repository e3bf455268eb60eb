"""The compiled kernel of the paper's active-set method."""
