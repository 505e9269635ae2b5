"""Evaluation of a run against the simulated truth."""
