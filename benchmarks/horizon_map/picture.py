"""Figure of the map: error over that of the best horizon against the horizon, by thirds of each group."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from benchmarks.horizon_map.places import GROUPS, Place, relative, thirds
from services.reporting.figures import sheet
from services.reporting.plots import palette

MARKERS = ("o", "s", "^")


def draw(maps: Mapping[str, Sequence[Place]], path: Path) -> None:
    """Draw rows of panels, with one column for each campaign."""
    with sheet.style(page=True):
        figure = Figure(figsize=(3.4 * len(maps), 8.6), layout="constrained")
        axes = figure.subplots(len(GROUPS), len(maps), sharex=True, sharey=True, squeeze=False)
        for j, (name, of) in enumerate(maps.items()):
            errors = relative(of)
            for i, group in enumerate(GROUPS):
                axis = axes[i][j]
                parts = zip(thirds(of, group), ("lowest", "middle", "highest"), palette.RUNS, MARKERS, strict=False)
                for part, third, colour, marker in parts:
                    median = np.median(errors[part], axis=0)
                    axis.plot(of[0].horizons_s, median, color=colour, marker=marker, label=f"{third} third")
                axis.set_xscale("log")
                axis.set_yscale("log")
                axis.set_title(f"{name}: {group}")
                if j == 0:
                    axis.set_ylabel("error / error of the\nbest horizon")
                if i == len(GROUPS) - 1:
                    axis.set_xlabel("horizon (s)")
                    axis.set_xticks(of[0].horizons_s, [f"{h:g}" for h in of[0].horizons_s])
                    axis.minorticks_off()
        sheet.shared_legend(figure, axes[0][0])
        sheet.write(figure, [path])
