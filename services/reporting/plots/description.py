"""Description of a plot: which columns of which table are drawn, in which style and unit.

A description holds no data of a run and is independent of the renderer: ``static/plots.js`` for the live page and the
report, ``benchmarks/paper/renderer.py`` for the figures of the pages.
"""

from __future__ import annotations

import enum

import msgspec

NO_DATA = "no data yet"


class Style(enum.StrEnum):
    """Drawing style of a series."""

    LINE = "line"
    DASHED = "dashed"
    DOTTED = "dotted"
    CROSS = "cross"  # current position of something
    POINT = "point"  # one of many
    DOT = "dot"
    RING = "ring"
    BAND = "band"  # filled between x and x_high, or y and y_high


class Group(enum.StrEnum):
    """Question that a part of the page and of the report answers; they show the parts in this order."""

    SAFE = "Is it safe?"  # in words and tables, no plots
    LINE = "Is it on its line?"
    WHY = "Why, or why not?"
    REVIEW = "What does a reviewer ask?"


class Series(msgspec.Struct, frozen=True):
    """Data series: columns ``x`` and ``y`` of a table. For a band, ``x_high`` or ``y_high`` is the other edge."""

    label: str
    table: str
    x: str
    y: str
    colour: str
    style: Style = Style.LINE
    x_high: str = ""
    y_high: str = ""
    compared: bool = False  # drawn for each run when several runs are overlaid


class Level(msgspec.Struct, frozen=True):
    """Horizontal line at a value of the run; not drawn if the run does not have the value."""

    label: str
    value: str
    colour: str


class Axis(msgspec.Struct, frozen=True):
    """Axis of a plot. ``label`` ends with the unit in parentheses."""

    label: str
    downwards: bool = False  # larger values are lower, as for a depth
    log: bool = False
    min_span: float | None = None  # smallest range shown, so that noise does not look like motion
    rows: tuple[str, ...] = ()  # names of the values 0, 1, ...
    time: bool = False  # vehicle time: the axes of all plots have one range, and events are drawn as marks


TIME = Axis("time (s)", time=True)


class Plot(msgspec.Struct, frozen=True, kw_only=True):
    """Plot of a run."""

    name: str
    title: str
    x: Axis = TIME
    y: Axis
    series: tuple[Series, ...]
    levels: tuple[Level, ...] = ()
    equal: bool = False  # the same scale on both axes
    from_start: bool = False  # data before t = 0 are hidden as soon as there are later ones
    empty: str = NO_DATA  # text shown without data
    note: str = ""  # explanation shown with the title
    group: str = Group.WHY  # a question of the report, or the heading of another page
    drifts: bool = False  # counts from the first message: a plot that began late says from when
    diving: bool = False  # the report of a surface craft leaves the plot out
    follow: tuple[str, ...] = ()  # tables around which the view can follow the vehicle
