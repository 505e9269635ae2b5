"""Table of the figures of the paper (Medagoda & Williams, OCEANS 2012): which plots of which runs.

Panels are stacked at the width of a column. All time axes start at t = 0, the start of the descent.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
from matplotlib.figure import Figure

from benchmarks import sheet
from benchmarks.paper import renderer
from benchmarks.paper.renderer import Run
from services.reporting.plots import catalogue
from services.reporting.plots.delays import CYCLE, STAGES
from services.reporting.plots.description import Axis, Plot

NONE, PAPER_SHORT, PAPER_LONG = "paper-no-control", "paper-2.5s", "paper-5s"
OURS_SHORT, OURS_LONG, DEFAULT = "ours-2.5s", "ours-5s", "default"
"""Groups of runs with one recorded run each."""

SYNTHETIC, MEASURED = "synthetic", "measured"
"""Groups of current profiles, in table ``profile`` like those of a run."""

TIMING = "timing"
"""Group with one run, which holds the table of ``TIMES``."""

THE_PAPER, OURS = "the paper's cost and delays", "this project's"

CASES = (NONE, PAPER_SHORT, PAPER_LONG), (NONE, OURS_SHORT, OURS_LONG)
"""The paper's three cases, and the same with this project's cost and without delay."""

DISTANCE = msgspec.structs.replace(catalogue.TRACKING, y=Axis(label="distance (m)", log=True))
"""Tracking error on a logarithmic axis, from 1 cm to 10 m."""


def only(plot: Plot, *labels: str, **changes: Any) -> Plot:
    """Return a plot with some of its series alone."""
    series = tuple(one for one in plot.series if one.label in labels)
    return msgspec.structs.replace(plot, series=series, **changes)


TRACKING = only(DISTANCE, "estimate")
ESTIMATED = only(catalogue.NORTH, "estimate"), only(catalogue.EAST, "estimate")
TRUE = only(catalogue.NORTH, "true"), only(catalogue.EAST, "true")
TRUE_CURRENT = only(catalogue.CURRENT, "true north", "true east", note="")
CURRENT_ERROR = tuple(one for one in catalogue.REVIEW if one.name.startswith("current_error"))

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


def _both(plot: Plot, papers: tuple[str, ...], ours: tuple[str, ...]) -> tuple[Panel, Panel]:
    return Panel(THE_PAPER, plot, papers), Panel(OURS, plot, ours)


SHEETS = (
    Sheet(
        "fig03-currents",
        5.0,
        (
            Panel("synthetic: first-order Gauss-Markov", PROFILES, (SYNTHETIC,)),
            Panel("measured", PROFILES, (MEASURED,)),
        ),
    ),
    Sheet("fig04-current", 2.6, (Panel("", TRUE_CURRENT, (OURS_LONG,)),)),
    Sheet("fig06-estimate", 8.0, (*_both(ESTIMATED[0], *CASES), *_both(ESTIMATED[1], *CASES))),
    Sheet("fig07-tracking", 4.4, _both(TRACKING, *CASES)),
    Sheet("fig08-thrust-2.5s", 3.6, _both(catalogue.THRUST, (PAPER_SHORT,), (OURS_SHORT,))),
    Sheet("fig09-thrust-5s", 3.6, _both(catalogue.THRUST, (PAPER_LONG,), (OURS_LONG,))),
    Sheet("fig10-true", 8.0, (*_both(TRUE[0], *CASES), *_both(TRUE[1], *CASES))),
    Sheet(
        "fig11-current-error",
        8.0,
        _both(CURRENT_ERROR[0], (PAPER_LONG,), (OURS_LONG,)) + _both(CURRENT_ERROR[1], (PAPER_LONG,), (OURS_LONG,)),
    ),
    Sheet("timing", 2.4, (Panel("cycles of this project, 5.1 s of horizon", TIMES, (TIMING,)),)),
)


def write(content: Sheet, runs: Mapping[str, Sequence[Run]], files: Sequence[Path]) -> None:
    """Draw one figure and write it to each of ``files``, as PNG or SVG by suffix."""
    with sheet.style():
        figure = Figure(figsize=(sheet.COLUMN_IN, content.height_in), layout="constrained")
        all_axes = figure.subplots(len(content.panels), 1, squeeze=False)[:, 0]
        for axes, panel in zip(all_axes, content.panels, strict=True):
            shown = [renderer.from_zero(run) for group in panel.groups for run in runs[group]]
            renderer.draw(axes, panel.plot, shown, title=panel.title)
        sheet.write(figure, files)
