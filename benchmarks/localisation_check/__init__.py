"""Consistency of the localisation over many seeds."""
