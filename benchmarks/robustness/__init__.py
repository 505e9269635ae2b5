"""Robustness table: one plant after another that differs from its file, flown by the controller and its rivals."""
