"""Wind, waves, current, squalls, and their random streams."""
