"""Figure of the map, from its summary: error of each horizon, and the horizon that is enough.

.venv/bin/python -m benchmarks.horizon_map.picture docs/horizon.json docs/figures/horizon.png
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks import sheet
from services.reporting.plots import palette

RATIOS = (1, 1.5, 2, 3, 5, 10)
"""Ticks of the axis of the error."""


def draw(campaigns: Mapping[str, Mapping[str, Any]], path: Path) -> None:
    """Draw two panels for each campaign: the error of each horizon above, the horizon that is enough below."""
    with sheet.style(page=True):
        figure = Figure(figsize=(sheet.PAGE_IN, 5.4), layout="constrained")
        panels = figure.subplots(2, len(campaigns), sharex=True, sharey="row", squeeze=False)
        for (name, of), (errors, enough) in zip(campaigns.items(), panels.T, strict=True):
            _errors(errors, of)
            _enough(enough, of)
            errors.set_title(name)
            enough.set_xscale("log")
            enough.set_xticks(of["horizons_s"], [f"{h:g}" for h in of["horizons_s"]])
            enough.minorticks_off()
            enough.set_xlabel("horizon (s)")
        panels[0][0].set_ylabel("error / error of the\nbest horizon at the place")
        panels[1][0].set_ylabel("places where it is the\nshortest that is enough")
        sheet.shared_legend(figure, panels[0][0])
        sheet.write(figure, [path])


def _errors(axes: Axes, of: Mapping[str, Any]) -> None:
    """Draw the median and the 90th percentile of the places."""
    curves = (("median", "median of the places", palette.OTHER), ("p90", "nine of ten places are below", palette.RARE))
    for key, label, colour in curves:
        ratios = [of["error_over_best"][str(h)][key] for h in of["horizons_s"]]
        axes.plot(of["horizons_s"], ratios, "o-", color=colour, label=label)
    axes.set_yscale("log")
    axes.set_yticks(RATIOS, [f"{ratio:g}" for ratio in RATIOS])
    axes.minorticks_off()


def _enough(axes: Axes, of: Mapping[str, Any]) -> None:
    """Draw a bar for each horizon, as wide as the ratio of two horizons on a logarithmic axis."""
    counts = [of["enough"][str(h)] for h in of["horizons_s"]]
    widths = [0.25 * h for h in of["horizons_s"]]
    bars = axes.bar(of["horizons_s"], counts, widths, color=palette.OTHER)
    axes.margins(y=0.12)
    axes.bar_label(bars, padding=2)


if __name__ == "__main__":
    draw(json.loads(Path(sys.argv[1]).read_text(encoding="utf-8")), Path(sys.argv[2]))
