"""The page people look at: one file with its data, its figures and one selection."""
