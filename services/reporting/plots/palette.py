"""Plot colours by meaning, on a light and on a dark background.

A colour means the same in every panel of page, report and figures: true black, estimate blue, reference grey, port
orange, starboard green, water current indigo. A band is a tint of the line whose uncertainty it shows; the uncertainty
of the estimated position is a tint of the estimate's blue. In a plot of several runs a colour of ``RUNS`` means a run,
and none of them is near a colour with another meaning. A test checks this, and that colours remain different for the
three kinds of colour blindness.
"""

from __future__ import annotations

TRUTH = "#1b1b1b"
ESTIMATE = "#0072b2"
REFERENCE = "#767676"
PLAN = "#cc5fa0"
PORT = "#d55e00"
STARBOARD = "#009e73"
NORTH = "#7b3294"
EAST = "#9a6f00"
CURRENT = "#3b2bb0"
LIMIT = "#8c1d18"
MARK = "#a0522d"
RARE = "#b36b00"
OTHER = "#455a64"
"""Quantities without a colour of their own: vertical thrust, energy, times."""

CANVAS = {"ink": "#2b2f33", "grid": "#e6e8eb", "paper": "#ffffff"}
"""Letters, grid lines and background of a plot. Page and report have them in ``static/style.css``, with a dark set."""

RUNS = ("#30a8b0", "#a81050", "#78a800", "#c050d0", "#004000", "#f84860", "#606800", "#600050")
"""Colours of several runs, settings or sensors in one plot; they repeat after the eighth."""

DARK = {
    TRUTH: "#f2f2f2",
    ESTIMATE: "#56b4e9",
    REFERENCE: "#9aa0a6",
    PLAN: "#ee96c8",
    PORT: "#ff8f3f",
    STARBOARD: "#2bc795",
    NORTH: "#c792ea",
    EAST: "#e0b040",
    CURRENT: "#7a6cf5",
    LIMIT: "#f28b82",
    MARK: "#dd9a6c",
    RARE: "#f0b45c",
    OTHER: "#a7bcc7",
    "#30a8b0": "#00e0ff",
    "#a81050": "#e83078",
    "#78a800": "#c0ff98",
    "#c050d0": "#d060f8",
    "#004000": "#508828",
    "#f84860": "#ffc0c0",
    "#606800": "#a8b828",
    "#600050": "#c840a8",
}
"""Colour on a dark background for each of the colours above."""
