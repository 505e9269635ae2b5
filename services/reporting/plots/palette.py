"""Colours by what they mean: Okabe and Ito's, told apart by the colour-blind; all dark enough to be read on white."""

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
"""Of a cycle, in their order."""

RUNS = ("#0072b2", "#d55e00", "#009e73", "#cc5fa0", "#b8860b", "#56b4e9", "#1b1b1b", "#767676")
"""Of several runs in one plot; beyond the eighth they come again."""
