"""Plots as PNG and SVG: by matplotlib, from the descriptions that page and report are drawn from."""
