"""Figure of the README: horizontal tracks of several runs, tracking error and thrusts of the last one."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import msgspec
from matplotlib.figure import Figure

from services.reporting.figures import renderer, sheet
from services.reporting.figures.renderer import Run
from services.reporting.plots import catalogue, palette
from services.reporting.plots.description import Series, Style

WITH_SPREAD = msgspec.structs.replace(
    catalogue.TRACKING,
    series=(
        Series(
            label="2 sigma of the filter",
            table="errors",
            x="t_s",
            y="minus_2_sigma_m",
            y_high="plus_2_sigma_m",
            colour=palette.ESTIMATE,
            style=Style.BAND,
        ),
        *catalogue.TRACKING.series,
    ),
)
"""Distance from the reference, with 2 sigma of the position error gained since t = 0."""


def write(runs: Sequence[Run], out: Path) -> None:
    """Draw the figure. The tracks of all ``runs`` are compared; the last run is also shown in detail."""
    shown = [renderer.from_zero(run) for run in runs]
    last = shown[-1]
    with sheet.style(page=True):
        picture = Figure(figsize=(sheet.PAGE_IN, 4.6), layout="constrained")
        grid = picture.add_gridspec(2, 2, width_ratios=(1.0, 1.35))
        above = picture.add_subplot(grid[:, 0])
        renderer.draw(above, catalogue.TRACK, shown, title="true horizontal track")
        distance = picture.add_subplot(grid[0, 1])
        renderer.draw(distance, WITH_SPREAD, [last], title=f"{last.name}: distance from the line")
        distance.set_ylim(bottom=0.0)
        renderer.draw(picture.add_subplot(grid[1, 1]), catalogue.THRUST, [last], title=f"{last.name}: thrust")
        sheet.write(picture, [out])
