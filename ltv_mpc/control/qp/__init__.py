"""Quadratic programme of one cycle: its form and layout, its Riccati recursion, its residuals and diagnostics."""
