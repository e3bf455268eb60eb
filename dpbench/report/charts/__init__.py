"""Figures as Vega-Lite specifications: the same on the page, as SVG, PDF or PNG, and in a
notebook."""
