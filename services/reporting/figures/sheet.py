"""Figure sheet of one or more panels: size, fonts and output files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

COLUMN_IN = 3.4
"""Width of a column of a two-column paper (in)."""

PAGE_IN = 6.8
"""Width of the figure in the README (in); its letters can be read at half of the width of a page."""

DPI = 200

STYLE: Any = {
    "font.size": 7.0,
    "axes.titlesize": 7.5,
    "axes.labelsize": 7.0,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e6e8eb",
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


def write(figure: Figure, files: Sequence[Path]) -> None:
    """Write a figure as PNG or SVG by suffix, within the ``style`` in which it was drawn. Creates folders."""
    for path in files:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=DPI, metadata={"Date": None} if path.suffix == ".svg" else None)
        figure.set_layout_engine("none")  # the layout, most of the work, is done once for all files
