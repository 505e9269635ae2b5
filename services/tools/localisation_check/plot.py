"""Plot of consistency over time: for each quantity its NEES per degree of freedom and the 95 % band."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from services.reporting.figures import sheet
from services.reporting.plots import palette
from services.tools.localisation_check.check import Graded

COLUMNS = 3


def draw(nees: Mapping[str, Graded], title: str, out: Path) -> None:
    """Write the plot."""
    with sheet.style(page=True):
        sheet.write(_figure(nees, title), [out])


def _figure(nees: Mapping[str, Graded], title: str) -> Figure:
    rows = -(-len(nees) // COLUMNS)
    figure = Figure(figsize=(9.0, 0.7 + 1.75 * rows), layout="constrained")
    panels = figure.subplots(rows, COLUMNS, sharex=True, squeeze=False)
    for panel, (name, graded) in zip(panels.flat, nees.items(), strict=False):
        _panel(panel, name, graded)
    for panel in panels.flat[len(nees) :]:
        panel.set_axis_off()
    for column in range(COLUMNS):
        lowest = max(row for row in range(rows) if row * COLUMNS + column < len(nees))
        panels[lowest, column].set_xlabel("time (s)")
        panels[lowest, column].tick_params(labelbottom=True)
    for row in panels:
        row[0].set_ylabel("NEES / dof")
    figure.suptitle(title)
    sheet.shared_legend(figure, panels.flat[0])
    return figure


def _panel(panel: Axes, name: str, graded: Graded) -> None:
    t, c = graded.t_s, graded.consistency
    mean, low, high = c.total / c.dof, c.low / c.dof, c.high / c.dof
    outside = (mean < low) | (mean > high)
    panel.fill_between(
        t, low, high, color=palette.REFERENCE, alpha=0.3, linewidth=0, label="95 % of a consistent filter"
    )
    panel.axhline(1.0, color=palette.REFERENCE, linewidth=0.8, linestyle=":")
    panel.plot(t, mean, color=palette.ESTIMATE, label="mean over the runs")
    panel.plot(t[outside], mean[outside], ".", color=palette.LIMIT, markersize=3.5, label="outside")
    top = max(1.5 * float(np.max(high)) - 0.5, 1.05 * float(np.max(mean)))
    panel.set_ylim(0.0, top if len(t) else 2.0)
    panel.set_title(f"{name.replace('_', ' ')}: mean {c.per_dof:.2f}")
