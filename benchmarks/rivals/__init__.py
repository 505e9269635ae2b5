"""Comparison of the controller with common alternatives, and with itself without one of its parts."""
