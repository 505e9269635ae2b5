"""Matplotlib renderer of plot descriptions; ``static/plots.js`` does the same with plotly.

One run: every series of the plot, its levels, and events if x is vehicle time. Several runs: only the series marked
``compared``, with one colour for each run and one dash pattern for each series.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import cycle
from typing import NamedTuple, TypeAlias

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from benchmarks import sheet
from ltv_mpc.messages import Array
from services.reporting.plots import palette
from services.reporting.plots.description import Axis, Plot, Series, Style
from services.reporting.plots.events import Mark
from services.reporting.plots.table import Columns

Dash: TypeAlias = tuple[float, Sequence[float]] | None

LINES: dict[Style, Dash] = {Style.LINE: None, Style.DASHED: (0, (5, 2)), Style.DOTTED: (0, (1, 1.2))}
MARKERS = {Style.CROSS: "+", Style.POINT: ".", Style.DOT: "o", Style.RING: "o"}
COMPARED: tuple[Dash, ...] = (None, (0, (4, 1.5)), (0, (1, 1.2)))
"""Dash patterns of the first, second and third compared series, if several runs are overlaid."""

WIDTH = 1.1  # points
BAND = 0.22  # opacity
MARGIN, TIME_MARGIN, LOG_MARGIN = 0.05, 0.01, 0.15
"""Margins as a share of the axis span; on a logarithmic axis in decades."""

TIME = "t_s"
GAP_S, GAP_STEPS = 1.0, 5.0
"""A line ends where data are missing for longer than both: seconds, and mean steps; as in plots.js."""


class Run(NamedTuple):
    """Data drawn under one name: tables by name and column, values of levels, event marks."""

    name: str
    tables: Mapping[str, Columns]
    values: Mapping[str, float] = {}
    marks: Sequence[Mark] = ()


def from_zero(run: Run) -> Run:
    """Return the run without the rows and events before t = 0."""
    return run._replace(
        tables={name: _from_zero(columns) for name, columns in run.tables.items()},
        marks=[mark for mark in run.marks if mark.t_s >= 0.0],
    )


def _from_zero(columns: Columns) -> Columns:
    times = columns.get(TIME)
    if times is None:
        return columns
    kept = [i for i, t in enumerate(times) if t is not None and t >= 0.0]
    return {name: [cells[i] for i in kept] for name, cells in columns.items()}


def draw(axes: Axes, plot: Plot, runs: Sequence[Run], *, title: str | None = None, legend: bool = True) -> None:
    """Draw a plot with labels, limits and legend. ``title`` replaces the one of the description; "" for none."""
    drawn = _of_one(axes, plot, runs[0]) if len(runs) == 1 else _of_several(axes, plot, runs)
    axes.set(xlabel=plot.x.label, ylabel=plot.y.label)
    sheet.legend_above(axes, plot.title if title is None else title, drawn.legend if legend else ())
    if not drawn.x:
        axes.text(0.5, 0.5, plot.empty, transform=axes.transAxes, ha="center", va="center", color=palette.REFERENCE)
        return
    _limit(axes, "x", plot.x, np.concatenate(drawn.x), TIME_MARGIN if plot.x.time else MARGIN)
    _limit(axes, "y", plot.y, np.concatenate(drawn.y), MARGIN)
    if plot.y.rows:
        axes.set_yticks(range(len(plot.y.rows)), plot.y.rows)
        axes.set_ylim(len(plot.y.rows) - 0.5, -0.5)
    if plot.equal:
        axes.set_aspect("equal", adjustable="datalim")


class _Drawn:
    """Content of the axes: all coordinates that were drawn, and the legend entries."""

    def __init__(self) -> None:
        self.x: list[Array] = []
        self.y: list[Array] = []
        self.legend: list[Line2D | Patch] = []

    def add(self, x: Array, y: Array) -> None:
        """Add the coordinates of a series."""
        self.x.append(x)
        self.y.append(y)


# --- one run ---------------------------------------------------------------------------------------------------------


def _of_one(axes: Axes, plot: Plot, run: Run) -> _Drawn:
    drawn = _Drawn()
    for series in plot.series:
        handle = _band(axes, run, series, drawn) if series.style is Style.BAND else _line(axes, run, series, drawn)
        if handle is not None and series.label:
            drawn.legend.append(handle)
    if drawn.x:
        _levels(axes, plot, run, drawn)
    if plot.x.time:
        for mark in run.marks:
            axes.axvline(mark.t_s, color=palette.MARK, alpha=0.3, linewidth=0.7)
    return drawn


def _line(axes: Axes, run: Run, series: Series, drawn: _Drawn) -> Line2D | None:
    x, y = _column(run, series.table, series.x), _column(run, series.table, series.y)
    if not _known(x, y).any():
        return None
    drawn.add(x, y)
    if (marker := MARKERS.get(series.style)) is not None:
        face = "none" if series.style is Style.RING else series.colour
        size, edge = (3, 0.0) if series.style is Style.POINT else (7, 1.8)
        (line,) = axes.plot(
            x, y, marker, color=series.colour, markersize=size, mfc=face, markeredgewidth=edge, label=series.label
        )
    else:
        style = LINES[series.style]
        (line,) = axes.plot(x, y, color=series.colour, linestyle=style, linewidth=WIDTH, label=series.label)
    return line


def _band(axes: Axes, run: Run, series: Series, drawn: _Drawn) -> Patch | None:
    x, y = _column(run, series.table, series.x), _column(run, series.table, series.y)
    x_high = _column(run, series.table, series.x_high) if series.x_high else x
    y_high = _column(run, series.table, series.y_high) if series.y_high else y
    known = _known(x, y, x_high, y_high)
    if not known.any():
        return None
    drawn.add(np.concatenate([x[known], x_high[known]]), np.concatenate([y[known], y_high[known]]))
    outline_x = np.concatenate([x[known], x_high[known][::-1]])
    outline_y = np.concatenate([y[known], y_high[known][::-1]])
    axes.fill(outline_x, outline_y, color=series.colour, alpha=BAND, linewidth=0)
    return Patch(color=series.colour, alpha=BAND, linewidth=0, label=series.label)


def _levels(axes: Axes, plot: Plot, run: Run, drawn: _Drawn) -> None:
    """Draw the levels as horizontal lines; levels of the same label share one legend entry."""
    labels = set()
    for level in plot.levels:
        value = run.values.get(level.value)
        if value is None:
            continue
        line = axes.axhline(value, color=level.colour, linestyle=LINES[Style.DOTTED], linewidth=WIDTH)
        drawn.y.append(np.array([value]))
        if level.label not in labels:
            labels.add(level.label)
            line.set_label(level.label)
            drawn.legend.append(line)


# --- several ---------------------------------------------------------------------------------------------------------


def _of_several(axes: Axes, plot: Plot, runs: Sequence[Run]) -> _Drawn:
    drawn = _Drawn()
    compared = [series for series in plot.series if series.compared]
    for run, colour in zip(runs, cycle(palette.RUNS), strict=False):
        for series, style in zip(compared, cycle(COMPARED), strict=False):
            x, y = _column(run, series.table, series.x), _column(run, series.table, series.y)
            if not _known(x, y).any():
                continue
            if plot.equal:  # runs with different starting points are compared from a common origin
                x, y = _from_its_start(x), _from_its_start(y)
            drawn.add(x, y)
            axes.plot(x, y, color=colour, linestyle=style, linewidth=WIDTH)
        drawn.legend.append(Line2D([], [], color=colour, linewidth=WIDTH, label=run.name))
    if plot.equal and drawn.x:
        drawn.legend += axes.plot(0.0, 0.0, "+", color=palette.TRUTH, markersize=7, zorder=3, label="start")
    if len(compared) > 1:
        drawn.legend += [
            Line2D([], [], color=palette.TRUTH, linestyle=style, linewidth=WIDTH, label=series.label)
            for series, style in zip(compared, cycle(COMPARED), strict=False)
        ]
    return drawn


def _from_its_start(x: Array) -> Array:
    known = x[np.isfinite(x)]
    return x - known[0] if len(known) else x


# --- numbers and limits ----------------------------------------------------------------------------------------------


def _column(run: Run, table: str, name: str) -> Array:
    """Return a column (K,) with NaN for missing values and where data are missing; empty if the run lacks it."""
    columns = run.tables.get(table, {})
    values = _floats(columns.get(name, ()))
    times = _floats(columns.get(TIME, ()))
    if len(times) < 3:
        return values
    longest_s = max(GAP_S, GAP_STEPS * float(times[-1] - times[0]) / (len(times) - 1))
    return np.insert(values, np.flatnonzero(np.diff(times) > longest_s) + 1, math.nan)


def _floats(cells: Iterable[float | None]) -> Array:
    return np.array([math.nan if cell is None else cell for cell in cells], dtype=np.float64)


def _known(*columns: Array) -> Array:
    """Return the mask (K,) of the rows in which all columns are finite."""
    if len({len(column) for column in columns}) != 1:
        return np.zeros(0, dtype=bool)
    known: Array = np.all([np.isfinite(column) for column in columns], axis=0)
    return known


def _limit(axes: Axes, name: str, axis: Axis, shown: Array, margin: float) -> None:
    """Set the limits of an axis with a margin, ``min_span`` apart or more; values >= 0 have an axis y from zero."""
    known = shown[np.isfinite(shown) & (shown > 0.0)] if axis.log else shown[np.isfinite(shown)]
    set_limits = axes.set_xlim if name == "x" else axes.set_ylim
    ticks = axes.xaxis if name == "x" else axes.yaxis
    if axis.log:
        (axes.set_xscale if name == "x" else axes.set_yscale)("log")
        ticks.set_major_locator(LogLocator(numticks=6))
        ticks.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        ticks.set_minor_formatter(NullFormatter())
        if len(known):
            set_limits(float(known.min()) * 10**-LOG_MARGIN, float(known.max()) * 10**LOG_MARGIN)
        return
    ticks.set_major_locator(MaxNLocator(6))
    low, high = float(known.min()), float(known.max())
    missing = max(0.0, (axis.min_span or 1e-6) - (high - low)) / 2
    extra = missing + margin * (high - low + 2 * missing)
    ends = low - extra, high + extra
    if name == "y" and low >= 0.0 > ends[0] and not axis.downwards:
        ends = 0.0, max(ends[1], axis.min_span or 0.0)
    # auto=True: with equal scales on both axes, the axis with more space may extend its limits
    set_limits(*(ends[::-1] if axis.downwards else ends), auto=True)
