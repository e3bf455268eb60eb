"""Files that others made: their kind, size, depth and what they unpack to, checked first."""
