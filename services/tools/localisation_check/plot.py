"""Plot of consistency over time: for each quantity its NEES per degree of freedom and the 95 % band."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes

from services.tools.localisation_check.check import Graded

mpl.use("Agg")
import matplotlib.pyplot as plt

LINE, BAND, OUTSIDE = "#0072B2", "#999999", "#D55E00"
"""Colours of Okabe and Ito, distinct for colour-blind readers and in grey; points outside are also marked."""

COLUMNS = 3


def draw(nees: Mapping[str, Graded], title: str, out: Path) -> None:
    """Write the plot."""
    plt.rcParams.update({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False})
    rows = -(-len(nees) // COLUMNS)
    figure, panels = plt.subplots(
        rows, COLUMNS, figsize=(9.0, 0.7 + 1.75 * rows), layout="constrained", sharex=True, squeeze=False
    )
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
    figure.suptitle(title, fontsize=10)
    handles, labels = panels.flat[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False)
    figure.savefig(out, dpi=160)
    plt.close(figure)


def _panel(panel: Axes, name: str, graded: Graded) -> None:
    t, c = graded.t_s, graded.consistency
    mean, low, high = c.total / c.dof, c.low / c.dof, c.high / c.dof
    outside = (mean < low) | (mean > high)
    panel.fill_between(t, low, high, color=BAND, alpha=0.35, linewidth=0, label="95 % of a consistent filter")
    panel.axhline(1.0, color="black", linewidth=0.6, linestyle=":")
    panel.plot(t, mean, color=LINE, linewidth=1.2, label="mean over the runs")
    panel.plot(t[outside], mean[outside], ".", color=OUTSIDE, markersize=3.5, label="outside")
    top = max(1.5 * float(np.max(high)) - 0.5, 1.05 * float(np.max(mean)))
    panel.set_ylim(0.0, top if len(t) else 2.0)
    panel.set_title(f"{name.replace('_', ' ')}: mean {c.per_dof:.2f}", fontsize=9)
