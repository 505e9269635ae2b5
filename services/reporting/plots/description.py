"""The description of a plot: which columns of which table are drawn, how, and in what units.

Nothing here knows a number of any run, nor who draws: ``static/plots.js`` on page and in report,
``figures/renderer.py`` in pictures.
"""

from __future__ import annotations

import enum

import msgspec


class Style(enum.StrEnum):
    """How a series is drawn."""

    LINE = "line"
    DASHED = "dashed"
    DOTTED = "dotted"
    CROSS = "cross"  # where something is now
    BAND = "band"  # filled between x and x_high, or y and y_high


class Series(msgspec.Struct, frozen=True, kw_only=True):
    """Columns ``x`` and ``y`` of a table. Of a band, ``x_high`` or ``y_high`` names its other edge."""

    label: str
    table: str
    x: str
    y: str
    colour: str
    style: Style = Style.LINE
    x_high: str = ""
    y_high: str = ""
    compared: bool = False  # it is drawn for each run where several are laid over each other


class Level(msgspec.Struct, frozen=True, kw_only=True):
    """A line across the plot at one of the run's values; not drawn where the run does not know it."""

    label: str
    value: str
    colour: str


class Axis(msgspec.Struct, frozen=True, kw_only=True):
    """One axis. ``label`` ends with the unit in parentheses."""

    label: str
    downwards: bool = False  # the larger, the lower
    log: bool = False
    min_span: float | None = None  # shows at least so much, so that noise does not look like motion


class Plot(msgspec.Struct, frozen=True, kw_only=True):
    """One plot. Where ``x`` is vehicle time, events stand in it as marks."""

    name: str
    title: str
    x: Axis
    y: Axis
    series: tuple[Series, ...]
    levels: tuple[Level, ...] = ()
    over_time: bool = True
    equal: bool = False  # a metre is as long on both axes
    from_start: bool = False  # what was before t = 0 is not shown, once there is something after it
    empty: str = "nothing yet"  # where there is nothing to draw
    note: str = ""  # what a reader has to know to read it
