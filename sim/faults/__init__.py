"""Fault models outside the code under test: sensors, message transport, solver, and the plant's environment."""
