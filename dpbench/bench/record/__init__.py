"""Records of a run: its cell, its raw log, its result folder and its machine."""
