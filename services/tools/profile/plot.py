"""Plot of a latency profile: distribution of cycle times, and their growth with the horizon."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, NullLocator

from services.reporting import sheet
from services.reporting.plots import palette
from services.tools.profile import machine_description
from services.tools.profile.measure import Samples
from services.tools.profile.run import Measured, Row

MARKERS = "osD^vP*X"
"""They tell the solvers apart in grey."""

COLUMNS = 3


class _Line(NamedTuple):
    """Row with its samples and its line style."""

    row: Row
    samples: Samples
    colour: str
    marker: str


def draw(measured: Measured, out: Path) -> None:
    """Write the plot: a panel for each horizon, and one for the growth with N if there are several."""
    with sheet.style(page=True):
        sheet.write(_figure(_lines(measured), machine_description.line(measured.profile.machine)), [out])


def _figure(lines: Sequence[_Line], machine: str) -> Figure:
    horizons = sorted({line.row.horizon_s for line in lines})
    panels = len(horizons) + (len(horizons) > 1)
    columns = 2 if panels == 4 else min(panels, COLUMNS)
    rows = -(-panels // columns)
    figure = Figure(figsize=(0.8 + 3.6 * columns, 1.0 + 3.2 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for panel, horizon_s in zip(axes, horizons, strict=False):
        _distribution(panel, [line for line in lines if line.row.horizon_s == horizon_s])
    if len(horizons) > 1:
        _growth(axes[panels - 1], lines)
    for unused in axes[panels:]:
        unused.set_axis_off()
    sheet.shared_legend(figure, axes[0])
    figure.suptitle(machine, fontsize=7)
    return figure


def _lines(measured: Measured) -> list[_Line]:
    rows = measured.profile.rows
    names = list(dict.fromkeys(row.solver for row in rows))
    return [
        _Line(row, samples, palette.RUNS[i % len(palette.RUNS)], MARKERS[i % len(MARKERS)])
        for row, samples in zip(rows, measured.samples, strict=True)
        for i in [names.index(row.solver)]
    ]


def _distribution(panel: Axes, lines: Sequence[_Line]) -> None:
    """Plot 1 - the empirical distribution function; log axes show the tail as wide as the middle."""
    for row, samples, colour, marker in lines:
        times = np.sort(samples.cycle_us)
        longer = 1.0 - np.arange(len(times)) / len(times)
        marks = np.searchsorted(-longer, [-0.5, -0.1, -0.01]).clip(max=len(times) - 1)
        panel.step(
            times,
            longer,
            where="pre",
            color=colour,
            marker=marker,
            markevery=marks.tolist(),
            label=row.solver,
        )
    panel.set(xscale="log", yscale="log", xlabel="time of a cycle (µs)", ylabel="share of cycles that take longer")
    _plain(panel.xaxis)
    panel.set_title(f"{lines[0].row.stages} stages, {lines[0].row.horizon_s:.1f} s")


def _growth(panel: Axes, lines: Sequence[_Line]) -> None:
    for name in dict.fromkeys(line.row.solver for line in lines):
        own = sorted((line for line in lines if line.row.solver == name), key=lambda line: line.row.stages)
        N = [line.row.stages for line in own]
        style: dict[str, Any] = {"color": own[0].colour, "marker": own[0].marker}
        panel.plot(N, [line.row.cycle_us.median for line in own], "-", **style)
        panel.plot(N, [line.row.cycle_us.p99 for line in own], ":", **style)
    N = sorted({line.row.stages for line in lines})
    lowest = 0.8 * min(line.row.cycle_us.median for line in lines if line.row.stages == N[0])
    panel.plot(N, [lowest * n / N[0] for n in N], color=palette.REFERENCE, linestyle="--")
    end = (N[-1], lowest * N[-1] / N[0])
    panel.annotate("in proportion to N", end, ha="right", va="top", fontsize="small", color=palette.REFERENCE)
    panel.set(xscale="log", yscale="log", xlabel="stages N", ylabel="time of a cycle (µs)")
    _plain(panel.yaxis)
    panel.set_xticks(N, [str(n) for n in N])
    panel.xaxis.set_minor_locator(NullLocator())
    panel.set_title("median, and p99 dotted")


def _plain(axis: Axis) -> None:
    """Label the axis with plain numbers at 1, 2 and 5 of each decade."""
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    axis.set_minor_formatter(NullFormatter())
