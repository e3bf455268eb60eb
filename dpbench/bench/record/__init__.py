"""What is kept of a run: its cell, its raw log, the result folder, the machine."""
