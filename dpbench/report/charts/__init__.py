"""Figures as Vega-Lite specifications, for the page, files and notebooks."""
