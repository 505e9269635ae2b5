"""Figures as PNG and SVG, drawn by matplotlib from the plot descriptions of the live page and the report."""
