"""Figures and tables of the paper from runs of this project: ``python -m benchmarks.paper``."""
