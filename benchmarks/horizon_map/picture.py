"""Figure of the map: error over that of the best horizon against the horizon, by thirds of each group."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from benchmarks.horizon_map.places import GROUPS, Place, relative, thirds

COLOURS = ("#0072B2", "#D55E00", "#009E73")
MARKERS = ("o", "s", "^")


def draw(maps: Mapping[str, Sequence[Place]], path: Path) -> None:
    """Draw rows of panels, with one column for each campaign."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(
        len(GROUPS), len(maps), figsize=(3.4 * len(maps), 8.6), sharex=True, sharey=True, squeeze=False
    )
    for j, (name, of) in enumerate(maps.items()):
        errors = relative(of)
        for i, group in enumerate(GROUPS):
            axis = axes[i][j]
            parts = zip(thirds(of, group), ("lowest", "middle", "highest"), COLOURS, MARKERS, strict=True)
            for part, third, colour, marker in parts:
                median = np.median(errors[part], axis=0)
                axis.plot(of[0].horizons_s, median, color=colour, marker=marker, markersize=4, label=f"{third} third")
            axis.set_xscale("log")
            axis.set_yscale("log")
            axis.set_title(f"{name}: {group}", fontsize=9, loc="left")
            axis.grid(color="#e6e8eb")
            if j == 0:
                axis.set_ylabel("error / best")
            if i == len(GROUPS) - 1:
                axis.set_xlabel("horizon (s)")
                axis.set_xticks(of[0].horizons_s, [f"{h:g}" for h in of[0].horizons_s])
                axis.minorticks_off()
    axes[0][0].legend(fontsize=7, frameon=False)
    figure.tight_layout()
    figure.savefig(path, dpi=150)
    plt.close(figure)
