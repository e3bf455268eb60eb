"""Engines that run the cells of a campaign: this machine, or the workers of a cluster."""
