"""Figure of the README: tracks and distances of several runs, and the thrusts of the last one."""

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


def write(runs: Sequence[Run], out: Path) -> None:
    """Draw the figure. All ``runs`` are compared; the last one is also shown with its thrusts."""
    shown = [renderer.from_zero(run) for run in runs]
    last = shown[-1]
    with sheet.style(page=True):
        picture = Figure(figsize=(sheet.PAGE_IN, 4.6), layout="constrained")
        grid = picture.add_gridspec(2, 2, width_ratios=(1.0, 1.35), height_ratios=(1.3, 1.0))
        renderer.draw(picture.add_subplot(grid[:, 0]), catalogue.TRACK, shown, title="true track from above")
        renderer.draw(picture.add_subplot(grid[0, 1]), TRUE_DISTANCE, shown, title="distance from the line")
        renderer.draw(picture.add_subplot(grid[1, 1]), catalogue.THRUST, [last], title=f"{last.name}: thrust")
        sheet.write(picture, [out])
