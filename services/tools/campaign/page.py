"""HTML report of a campaign: effect of each varied field on the figure, and the best points, in one offline file.

A grid shows, for each field, the mean over seeds at each of its values, a line for each value of the next field, with
95 % intervals; a random or Sobol design shows its points.
"""

from __future__ import annotations

import html
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from services.reporting import report
from services.reporting.html_table import table
from services.reporting.plots import palette
from services.reporting.plots.description import Axis, Plot, Series, Style
from services.reporting.plots.table import Columns
from services.runtime.console import counted
from services.tools.campaign.campaign import reopen_campaign
from services.tools.campaign.file import Campaign, Range
from services.tools.campaign.ranking import HEAD, ConfidenceInterval, Scores, cells, failures, interval, ranked, scores

NAME = "report.html"
MAX_POINTS, MAX_LINES = 40, 8


def write(folder: Path) -> Path:
    """Write the report of a campaign's folder, finished or not. Raises ``NoPlotly``, ``ConfigError``, ``OSError``."""
    made, found = reopen_campaign(folder)
    campaign, rows = made.campaign, list(found)
    of = scores(rows, campaign.minimise, campaign.varied)
    best = table("The best points", [(*campaign.varied, *HEAD), *map(cells, ranked(of, MAX_POINTS))], numbers=True)
    counts = f"{counted(len(rows), 'run')} at {counted(len(of.values), 'point')}"
    lines = [
        html.escape(f"{counts}, {campaign.design.kind} design: {campaign.scenario}"),
        f"{html.escape(campaign.minimise)}: mean over seeds, bands of 95 % by bootstrap, differences paired by seed",
        *(f'<span class="bad">{html.escape(line)}</span>' for line in failures(rows)),
    ]
    out = folder / NAME
    panels = [_panel(campaign, of, key) for key in campaign.varied]
    tables = {name: columns for _, tables in panels for name, columns in tables.items()}
    report.write_plots(
        out,
        campaign.title,
        [plot for plot, _ in panels],
        tables,
        lines="\n".join(f"<p>{line}</p>" for line in lines),
        below=f'<section class="panel wide"><h2>The best points</h2>{best}</section>',
    )
    return out


def _panel(campaign: Campaign, of: Scores, key: str) -> tuple[Plot, dict[str, Columns]]:
    """Return the plot of one varied field, and its tables."""
    keys, over = list(campaign.varied), campaign.varied[key]
    rows: tuple[str, ...] = ()
    if not isinstance(over, Range) and any(isinstance(value, str | bool) for value in over):
        rows = tuple(map(str, over))

    def place(value: Any) -> float:
        return float(rows.index(str(value)) if rows else value)

    series: list[Series] = []
    tables: dict[str, Columns] = {}
    if campaign.design.kind == "grid" or key in campaign.cross:
        second = keys[(keys.index(key) + 1) % len(keys)] if len(keys) > 1 and campaign.design.kind == "grid" else None
        for number, (label, means) in enumerate(_lines(of, key, second, campaign)):
            colour, name = palette.RUNS[number % len(palette.RUNS)], f"{key}, {label}"
            tables[name] = {
                "x": [place(x) for x in means],
                "mean": [found.mean for found in means.values()],
                "low": [found.low for found in means.values()],
                "high": [found.high for found in means.values()],
            }
            series.append(Series("", name, "x", "low", colour, Style.BAND, y_high="high"))
            series += [Series(label, name, "x", "mean", colour, style) for style in (Style.LINE, Style.DOT)]
    else:
        there = [point for point, values in sorted(of.values.items()) if values]
        tables[key] = {
            "x": [place(of.settings[point][key]) for point in there],
            "mean": [float(np.mean(list(of.values[point].values()))) for point in there],
        }
        series.append(Series("", key, "x", "mean", palette.ESTIMATE, Style.POINT))
    x, y = Axis(key, log=isinstance(over, Range) and over.scale == "log", rows=rows), Axis(campaign.minimise)
    plot = Plot(name=key, title=key, x=x, y=y, group="Effect of each field", series=tuple(series))
    return plot, tables


def _lines(
    of: Scores, key: str, second: str | None, campaign: Campaign
) -> Iterable[tuple[str, dict[Any, ConfidenceInterval]]]:
    """Generate label and means of one line for each value of the field ``second``."""
    second_values = campaign.varied[second] if second is not None else ()
    values = second_values[:MAX_LINES] if second is not None and not isinstance(second_values, Range) else [None]
    own = campaign.varied[key]
    assert not isinstance(own, Range)  # a grid's
    for value in values:
        at = {x: _over(of, {key: x} | ({second: value} if second is not None else {})) for x in own}
        label = "" if second is None else f"{second.rpartition('.')[2]} {value}"
        yield label, {x: found for x, found in at.items() if found is not None}


def _over(of: Scores, settings: Mapping[str, object]) -> ConfidenceInterval | None:
    """Average over all points with these settings and over seeds; the interval is over seeds."""
    points = [p for p, own in of.settings.items() if all(own[key] == value for key, value in settings.items())]
    by_seed: dict[int, list[float]] = {}
    for point in points:
        for seed, value in of.values[point].items():
            by_seed.setdefault(seed, []).append(value)
    means = [float(np.mean(values)) for _, values in sorted(by_seed.items())]
    return interval(np.array(means)) if means else None
