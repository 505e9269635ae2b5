"""Figures and tables of the paper from runs of this project: ``python -P -m services.tools.paper``."""
