"""Optimal control problem of one cycle: its form, the terms of its cost, its limits; no solver."""
