"""Stability of a controller, and the region it brings its ship back from."""
