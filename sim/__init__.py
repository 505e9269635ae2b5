"""Simulated vehicle and sea: the package to delete when the real ones arrive."""
