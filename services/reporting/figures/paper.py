"""The paper's figures, one row each: which plots of which runs. Medagoda & Williams, OCEANS 2012.

Panels stand below each other at the width of a column. All time axes begin at t = 0, where the descent begins.
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
from services.reporting.plots.description import Axis, Plot

NONE, PAPER_SHORT, PAPER_LONG = "none", "paper-2.5s", "paper-5s"
OURS_SHORT, OURS_LONG = "ours-2.5s", "ours-5s"
"""Groups of one recorded run each."""

SYNTHETIC, MEASURED = "synthetic", "measured"
"""Groups of profiles: table ``profile`` as a run's own."""

STRUCTURE, TIMING = "structure", "timing"
"""A group of one run each, with the tables of ``water.structure`` and of ``catalogue.LATENCY``."""

THE_PAPER, OURS = "the paper's cost and delays", "this project's"

DISTANCE = msgspec.structs.replace(catalogue.TRACKING, y=Axis(label="distance (m)", log=True))
"""From 1 cm to 10 m: the same series on a logarithmic axis."""

PROFILES = msgspec.structs.replace(catalogue.CURRENT, empty="no measured profiles here")


class Panel(NamedTuple):
    """One plot of the runs of these groups."""

    title: str
    plot: Plot
    groups: tuple[str, ...]


class Sheet(NamedTuple):
    """One file: its name, its height, its panels from the top."""

    name: str
    height_in: float
    panels: tuple[Panel, ...]


def sheets(measured: Sequence[str]) -> tuple[Sheet, ...]:
    """Every figure; ``measured`` are the names of the measured profiles."""
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
        Sheet("timing", 2.4, (Panel("cycles of this project, 5.1 s of horizon", catalogue.LATENCY, (TIMING,)),)),
    )


def _both(plot: Plot, papers: tuple[str, ...], ours: tuple[str, ...]) -> tuple[Panel, Panel]:
    return Panel(THE_PAPER, plot, papers), Panel(OURS, plot, ours)


def write(made: Sheet, runs: Mapping[str, Sequence[Run]], files: Sequence[Path]) -> None:
    """Draw one figure and write it to every one of ``files``, PNG or SVG by suffix."""
    with sheet.style():
        picture = Figure(figsize=(sheet.COLUMN_IN, made.height_in), layout="constrained")
        axes = picture.subplots(len(made.panels), 1, squeeze=False)[:, 0]
        for place, panel in zip(axes, made.panels, strict=True):
            shown = [renderer.from_zero(run) for group in panel.groups for run in runs[group]]
            renderer.draw(place, panel.plot, shown, title=panel.title)
        sheet.write(picture, files)
