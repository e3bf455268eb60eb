"""Observers: what the controller knows of the ship."""
