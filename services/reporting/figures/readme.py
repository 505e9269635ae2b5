"""Figure of the README: distances of several runs, and the thrusts of the last two beside each other."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import msgspec
from matplotlib.figure import Figure

from services.reporting.figures import paper, renderer, sheet
from services.reporting.figures.renderer import Run
from services.reporting.plots import catalogue

TRUE_DISTANCE = msgspec.structs.replace(
    paper.DISTANCE, series=tuple(one for one in paper.DISTANCE.series if one.table == "true_distance")
)
"""Distance of the vehicle from the reference, on a logarithmic axis."""

THRUST = msgspec.structs.replace(catalogue.THRUST, levels=())
"""Thrusts without their limits, for a short legend."""


def write(runs: Sequence[Run], out: Path) -> None:
    """Draw the figure. All ``runs`` are compared, and the last two are also shown with their thrusts.

    The last run is the one with the default horizon.
    """
    shown = [renderer.from_zero(run) for run in runs]
    named = [*shown[:-1], shown[-1]._replace(name=f"{shown[-1].name} (default)")]
    with sheet.style(page=True):
        picture = Figure(figsize=(sheet.HALF_PAGE_IN, 4.4), layout="constrained")
        grid = picture.add_gridspec(2, 2, height_ratios=(1.25, 1.0))
        renderer.draw(
            picture.add_subplot(grid[0, :]), TRUE_DISTANCE, named, title="distance of the vehicle from the line"
        )
        first = None
        for column, run in enumerate(shown[-2:]):
            axes = picture.add_subplot(grid[1, column], sharey=first)
            renderer.draw(axes, THRUST, [run], title=f"thrust, {run.name}")
            if first is not None:
                axes.set_ylabel("")
            first = axes
        sheet.write(picture, [out])
