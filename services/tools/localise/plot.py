"""Plots of a recorded dive: horizontal track, error over time with its standard deviation, current over depth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from ltv_mpc.messages import Array
from services.reporting import report
from services.reporting.plots import palette
from services.reporting.plots.catalogue import CURRENT
from services.reporting.plots.description import Axis, Plot, Series, Style
from services.reporting.plots.newest import profile_table
from services.reporting.plots.table import Columns, shorts
from services.reporting.plots.truth import outline

if TYPE_CHECKING:
    from services.tools.localise.dive_localisation import Outcome

RESULT = "Recorded dive"

PLOTS = (
    Plot(
        name="above",
        title="Horizontal track",
        x=Axis("east (m)"),
        y=Axis("north (m)"),
        equal=True,
        group=RESULT,
        series=(
            Series("bottom track", "truth", "east_m", "north_m", palette.TRUTH),
            Series("filter", "filter", "east_m", "north_m", palette.ESTIMATE),
            Series("constant velocity", "constant", "east_m", "north_m", palette.OTHER, Style.DASHED),
            Series("3 sigma of the filter at the end", "ellipse", "east_m", "north_m", palette.ESTIMATE, Style.DOTTED),
        ),
    ),
    Plot(
        name="error",
        title="Position error against bottom track",
        y=Axis("distance (m)"),
        group=RESULT,
        series=(
            Series(
                "3 sigma of the filter", "filter", "t_s", "zero", palette.ESTIMATE, Style.BAND, y_high="three_sigma_m"
            ),
            Series("filter", "filter", "t_s", "error_m", palette.ESTIMATE),
            Series("constant velocity", "constant", "t_s", "error_m", palette.OTHER, Style.DASHED),
        ),
    ),
    msgspec.structs.replace(
        CURRENT,
        title="Water current over depth, at the end",
        group=RESULT,
        note="Bands are two standard deviations.",
        series=tuple(series for series in CURRENT.series if series.table == "profile"),
    ),
)


def write(data: Outcome, out: Path) -> None:
    """Write the page of plots. Raises ``NoPlotly``."""
    track = data.track
    spread = np.sqrt(np.linalg.eigvalsh(track.position_covariance)[:, -1].clip(0))
    ring = track.position_m[-1] + outline(track.position_covariance[-1], 3.0)
    tables = {
        "truth": _columns(track.t_s, data.truth_m),
        "filter": _columns(track.t_s, track.position_m, data.truth_m)
        | {"zero": [0.0] * len(spread), "three_sigma_m": shorts(3.0 * spread)},
        "ellipse": _columns(np.zeros(len(ring)), ring),
        "profile": profile_table(track.water),
        "constant": {},
    }
    if data.constant_velocity_mps is not None:
        path = data.constant_velocity_mps * track.t_s[:, None]
        tables["constant"] = _columns(track.t_s, path, data.truth_m)
    report.write_plots(out, RESULT, PLOTS, tables)


def _columns(t_s: Array, position_m: Array, truth_m: Array | None = None) -> Columns:
    """Return the columns of a track (N, 2), with its distance from the truth if that is given."""
    columns = {"t_s": t_s, "north_m": position_m[:, 0], "east_m": position_m[:, 1]}
    if truth_m is not None:
        columns["error_m"] = np.hypot(*(position_m - truth_m).T)
    return {name: shorts(values) for name, values in columns.items()}
