"""Plot colours by meaning: the colour-blind safe palette of Okabe and Ito, dark enough for a white background."""

from __future__ import annotations

TRUTH = "#1b1b1b"
ESTIMATE = "#0072b2"
REFERENCE = "#767676"
PLAN = "#cc5fa0"
PORT = "#d55e00"
STARBOARD = "#009e73"
NORTH = "#0072b2"
EAST = "#d55e00"
LIMIT = "#767676"
MARK = "#a0522d"

STAGES = ("#56b4e9", "#009e73", "#b8860b", "#d55e00", "#cc5fa0")
"""Colours of the stages of a cycle, in their order."""

RUNS = ("#0072b2", "#d55e00", "#009e73", "#cc5fa0", "#b8860b", "#56b4e9", "#1b1b1b", "#767676")
"""Colours of several runs in one plot; they repeat after the eighth."""
