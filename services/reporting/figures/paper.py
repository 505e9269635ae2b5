"""Table of the figures of the paper (Medagoda & Williams, OCEANS 2012): which plots of which runs.

Panels are stacked at the width of a column. All time axes start at t = 0, the start of the descent.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec
from matplotlib.figure import Figure

from services.reporting.figures import renderer, sheet
from services.reporting.figures.renderer import Run
from services.reporting.figures.water import structure
from services.reporting.plots import catalogue
from services.reporting.plots.delays import CYCLE, STAGES
from services.reporting.plots.description import Axis, Plot

NONE, PAPER_SHORT, PAPER_LONG = "none", "paper-2.5s", "paper-5s"
OURS_SHORT, OURS_LONG, DEFAULT = "ours-2.5s", "ours-5s", "default"
"""Groups of runs with one recorded run each."""

SYNTHETIC, MEASURED = "synthetic", "measured"
"""Groups of current profiles, in table ``profile`` like those of a run."""

STRUCTURE, TIMING = "structure", "timing"
"""Groups with one run each, which holds the tables of ``water.structure`` or of ``TIMES``."""

THE_PAPER, OURS = "the paper's cost and delays", "this project's"

DISTANCE = msgspec.structs.replace(catalogue.TRACKING, y=Axis(label="distance (m)", log=True))
"""Tracking error on a logarithmic axis, from 1 cm to 10 m."""

PROFILES = msgspec.structs.replace(catalogue.CURRENT, empty="no measured profiles")


TIMES = msgspec.structs.replace(
    catalogue.STAGES,
    x=Axis(label="wall time (ms)", log=True),
    y=msgspec.structs.replace(catalogue.STAGES.y, rows=STAGES[: STAGES.index(CYCLE) + 1]),
)
"""Steps of a cycle, without the rows of a running vehicle: the way to the actuators and the age of the estimate."""


class Panel(NamedTuple):
    """One plot of the runs in ``groups``."""

    title: str
    plot: Plot
    groups: tuple[str, ...]


class Sheet(NamedTuple):
    """One figure file: name, height, and panels from top to bottom."""

    name: str
    height_in: float
    panels: tuple[Panel, ...]


def sheets(measured: Sequence[str]) -> tuple[Sheet, ...]:
    """Return every figure; ``measured`` are the names of the measured profiles."""
    return (
        Sheet(
            "fig03-currents",
            5.0,
            (
                Panel("synthetic: first-order Gauss-Markov", PROFILES, (SYNTHETIC,)),
                Panel("measured", PROFILES, (MEASURED,)),
            ),
        ),
        Sheet("fig03-structure", 2.6, (Panel("", structure(measured), (STRUCTURE,)),)),
        Sheet("track", 4.6, _both(catalogue.TRACK, (NONE, PAPER_SHORT, PAPER_LONG), (NONE, OURS_SHORT, OURS_LONG))),
        Sheet("distance", 4.4, _both(DISTANCE, (NONE, PAPER_SHORT, PAPER_LONG), (NONE, OURS_SHORT, OURS_LONG))),
        Sheet("thrust-2.5s", 3.6, _both(catalogue.THRUST, (PAPER_SHORT,), (OURS_SHORT,))),
        Sheet("thrust-5s", 3.6, _both(catalogue.THRUST, (PAPER_LONG,), (OURS_LONG,))),
        Sheet("localisation", 3.6, _both(catalogue.ERRORS, (PAPER_LONG,), (OURS_LONG,))),
        Sheet("current", 2.8, (Panel("estimated at the end, with 2 sigma", catalogue.CURRENT, (OURS_LONG,)),)),
        Sheet("depth", 2.0, (Panel("", catalogue.DEPTH, (OURS_LONG,)),)),
        Sheet("timing", 2.4, (Panel("cycles of this project, 5.1 s of horizon", TIMES, (TIMING,)),)),
    )


def _both(plot: Plot, papers: tuple[str, ...], ours: tuple[str, ...]) -> tuple[Panel, Panel]:
    return Panel(THE_PAPER, plot, papers), Panel(OURS, plot, ours)


def write(content: Sheet, runs: Mapping[str, Sequence[Run]], files: Sequence[Path]) -> None:
    """Draw one figure and write it to each of ``files``, as PNG or SVG by suffix."""
    with sheet.style():
        figure = Figure(figsize=(sheet.COLUMN_IN, content.height_in), layout="constrained")
        all_axes = figure.subplots(len(content.panels), 1, squeeze=False)[:, 0]
        for axes, panel in zip(all_axes, content.panels, strict=True):
            shown = [renderer.from_zero(run) for group in panel.groups for run in runs[group]]
            renderer.draw(axes, panel.plot, shown, title=panel.title)
        sheet.write(figure, files)
