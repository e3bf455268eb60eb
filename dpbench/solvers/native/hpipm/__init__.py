"""HPIPM through its own interface: dense, and by stages."""
