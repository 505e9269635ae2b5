"""Style sheet of the figures that matplotlib draws: sizes, fonts, colours, place of the legend, output files.

The colours are those of ``services.reporting.plots.palette``. Legends stand above or below the axes, never on the data.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
from cycler import cycler
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties

from services.reporting.plots import palette

COLUMN_IN = 3.4
"""Width of a column of a two-column paper (in)."""

PAGE_IN = 6.8
"""Width of a figure on a page of the documentation (in)."""

HALF_PAGE_IN = 4.8
"""Width of the figure in the README (in): its letters can be read at half of the width of a page."""

COLUMNS = 4
"""Largest number of columns of a legend."""

DPI = 200

STYLE: Any = {
    "font.size": 7.0,
    "axes.titlesize": 7.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelsize": 7.0,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": palette.CANVAS["grid"],
    "axes.prop_cycle": cycler(color=palette.RUNS),
    "text.color": palette.CANVAS["ink"],
    "axes.labelcolor": palette.CANVAS["ink"],
    "xtick.labelcolor": palette.CANVAS["ink"],
    "ytick.labelcolor": palette.CANVAS["ink"],
    "lines.linewidth": 1.2,
    "lines.markersize": 4.0,
    "legend.title_fontsize": "medium",
    "grid.linewidth": 0.5,
    "xtick.labelsize": 6.5,
    "ytick.labelsize": 6.5,
    "legend.fontsize": 6.0,
    "legend.frameon": False,
    "legend.borderpad": 0.0,
    "legend.handlelength": 2.0,
    "legend.handletextpad": 0.5,
    "legend.columnspacing": 1.2,
    "legend.labelspacing": 0.25,
    "svg.hashsalt": "ltv-mpc",  # equal figures give equal files
}
"""Style for the width of a column; ``PAGE`` holds the differences for the width of a page."""

PAGE: Any = {
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.labelsize": 9.0,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "legend.fontsize": 8.0,
}


@contextmanager
def style(*, page: bool = False) -> Iterator[None]:
    """Set fonts and line widths for a column or a page while a figure is drawn and written."""
    with mpl.rc_context():
        mpl.rcParams.update(STYLE)
        if page:
            mpl.rcParams.update(PAGE)
        yield


def legend_above(axes: Axes, title: str, handles: Sequence[Artist]) -> None:
    """Place title and legend above the axes, where they cover no data.

    Parameters
    ----------
    axes : of the panel.
    title : title of the panel; "" for none.
    handles : artists in the legend; with none of them the panel has a title alone.
    """
    if not handles:
        axes.set_title(title)
        return
    axes.legend(
        handles=handles,
        title=title or None,
        title_fontproperties={"weight": "bold"},
        alignment="left",
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        borderaxespad=0.3,
        ncols=_columns(axes, [str(one.get_label()) for one in handles]),
    )


def _columns(axes: Axes, labels: Sequence[str]) -> int:
    """Return the number of legend columns that fit above the axes.

    A letter is about 0.53 of the font size wide; a legend line with its gaps is 3.6 font sizes wide.
    """
    points = axes.get_window_extent().transformed(axes.figure.dpi_scale_trans.inverted()).width * 72
    letter = FontProperties(size=mpl.rcParams["legend.fontsize"]).get_size_in_points()
    widest = letter * (3.6 + 0.53 * max(map(len, labels)))
    return min(len(labels), COLUMNS, max(1, int(points / widest)))


def write(figure: Figure, files: Sequence[Path]) -> None:
    """Write a figure as PNG or SVG by suffix, within the ``style`` in which it was drawn. Creates folders."""
    for path in files:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=DPI, metadata={"Date": None} if path.suffix == ".svg" else None)
        figure.set_layout_engine("none")  # the layout, most of the work, is done once for all files
