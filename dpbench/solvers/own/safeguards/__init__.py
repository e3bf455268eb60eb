"""What lets the active-set method claim an answer in a crowded place."""
