"""Figure of the README: what a longer horizon buys, as error of the controller and as energy."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import msgspec
from matplotlib.figure import Figure

from benchmarks import sheet
from benchmarks.paper import renderer, sheets
from benchmarks.paper.renderer import Run
from services.reporting.plots import catalogue

CONTROL_ERROR = msgspec.structs.replace(
    sheets.DISTANCE, series=tuple(one for one in sheets.DISTANCE.series if one.table == "distance")
)
"""Distance of the estimate from the reference, on a logarithmic axis: the drift of the estimate is not in it."""

LEAST_M = 1e-3
"""Lower end of the axis of the distance (m): a passage through zero would fill half of a logarithmic axis."""

LATERAL_ENERGY = msgspec.structs.replace(
    catalogue.ENERGY,
    series=tuple(one for one in catalogue.ENERGY.series if one.y == "lateral_J"),
)
"""Energy of the lateral thrusters; the vertical one needs the same with each horizon."""


def write(runs: Sequence[Run], out: Path) -> None:
    """Draw error and energy of all ``runs``; the last one has the default horizon."""
    shown = [renderer.from_zero(run) for run in runs]
    shown[-1] = shown[-1]._replace(name=f"{shown[-1].name} (default)")
    with sheet.style(page=True):
        picture = Figure(figsize=(sheet.HALF_PAGE_IN, 4.4), layout="constrained")
        above, below = picture.subplots(2, 1, sharex=True, height_ratios=(1.2, 1.0))
        renderer.draw(above, CONTROL_ERROR, shown, title="distance of the estimate from the line")
        renderer.draw(below, LATERAL_ENERGY, shown, title="energy of the lateral thrusters", legend=False)
        above.set(xlabel="", ylim=(LEAST_M, None))
        sheet.write(picture, [out])
