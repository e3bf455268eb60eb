"""A folder for each solver: where its C comes from, and its shim."""
