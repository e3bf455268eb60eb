"""Files of QPs, ours and others'."""
