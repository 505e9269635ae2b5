"""HTML report of a campaign: effect of each varied field on the figure, and the best points, in one offline file.

A grid shows, for each field, the mean over seeds at each of its values, a line for each value of the next field, with
95 % intervals; a random or Sobol design shows its points.
"""

from __future__ import annotations

import html
import string
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from services.reporting import static_files
from services.reporting.plots import palette
from services.run.folder import draft_of
from services.runtime.console import counted
from services.tools.campaign.campaign import reopen_campaign
from services.tools.campaign.file import Campaign, Range
from services.tools.campaign.ranking import ConfidenceInterval, Scores, Standing, interval, ranked, scores
from services.tools.campaign.text import difference, failures, span

NAME = "report.html"
MAX_POINTS, MAX_LINES = 40, 8


def write(folder: Path) -> Path:
    """Write the report of a campaign's folder, finished or not. Raises ``NoPlotly``, ``ConfigError``, ``OSError``."""
    made, found = reopen_campaign(folder)
    campaign, rows = made.campaign, list(found)
    of = scores(rows, campaign.minimise, campaign.varied)
    best = ranked(of, MAX_POINTS)
    failed = [row for row in rows if row["failed"] is not None]
    counts = f"{counted(len(rows), 'run')} at {counted(len(of.values), 'point')}"
    lines = [
        html.escape(f"{counts}, {campaign.design.kind} design: {campaign.scenario}"),
        f"{html.escape(campaign.minimise)}: mean over seeds, 95 % intervals by bootstrap, differences paired by seed",
        *(f'<span class="bad">{html.escape(line)}</span>' for line in failures(failed)),
    ]
    text = string.Template(static_files.text("campaign.html")).substitute(
        title=html.escape(campaign.title),
        style=static_files.text("style.css") + static_files.text("report.css"),
        lines="\n".join(f"<p>{line}</p>" for line in lines),
        tables=_table(best, list(campaign.varied)),
        plotly=static_files.plotly(),
        data=msgspec.json.encode(panels(campaign, of)).decode().replace("<", "\\u003c"),
    )
    out = folder / NAME
    with draft_of(out) as draft:
        draft.write_text(text, encoding="utf-8")
    return out


def panels(campaign: Campaign, of: Scores) -> list[dict[str, Any]]:
    """Return one panel for each varied field: title, plotly's traces and layout."""
    keys, grid = list(campaign.varied), palette.CANVAS["grid"]
    made = []
    for i, key in enumerate(keys):
        over = campaign.varied[key]
        if campaign.design.kind == "grid" or key in campaign.cross:
            second = keys[(i + 1) % len(keys)] if len(keys) > 1 and campaign.design.kind == "grid" else None
            traces = list(_lines(of, key, second, campaign))
        else:
            traces = [_points(of, key)]
        x = {
            "title": {"text": html.escape(key)},
            "zeroline": False,
            "gridcolor": grid,
            "automargin": True,
        }
        if isinstance(over, Range):
            x["type"] = over.scale
        elif any(isinstance(value, str | bool) for value in over):
            x["type"] = "category"
        y = {
            "title": {"text": html.escape(campaign.minimise)},
            "rangemode": "tozero",
            "gridcolor": grid,
        }
        layout = {
            "xaxis": x,
            "yaxis": {**y, "automargin": True},
            "margin": {"l": 56, "r": 12, "t": 8, "b": 44},
            "showlegend": len(traces) > 1,
            "legend": {"orientation": "h", "y": -0.28, "font": {"size": 10}},
            "font": {"size": 11, "color": palette.CANVAS["ink"]},
            "paper_bgcolor": palette.CANVAS["paper"],
            "plot_bgcolor": palette.CANVAS["paper"],
        }
        made.append({"title": key, "traces": traces, "layout": layout})
    return made


def _lines(of: Scores, key: str, second: str | None, campaign: Campaign) -> Iterable[dict[str, Any]]:
    """Generate one line for each value of the field ``second``."""
    second_values = campaign.varied[second] if second is not None else ()
    values = second_values[:MAX_LINES] if second is not None and not isinstance(second_values, Range) else [None]
    own = campaign.varied[key]
    assert not isinstance(own, Range)  # a grid's
    for number, value in enumerate(values):
        at = {x: _over(of, {key: x} | ({second: value} if second is not None else {})) for x in own}
        there = [(x, found) for x, found in at.items() if found is not None]
        yield {
            "name": "" if second is None else f"{html.escape(second.rpartition('.')[2])} {value}",
            "x": [x for x, _ in there],
            "y": [found.mean for _, found in there],
            "error_y": {
                "type": "data",
                "symmetric": False,
                "array": [(found.high or found.mean) - found.mean for _, found in there],
                "arrayminus": [found.mean - (found.low or found.mean) for _, found in there],
                "thickness": 1,
            },
            "mode": "lines+markers",
            "line": {"color": palette.RUNS[number % len(palette.RUNS)]},
        }


def _over(of: Scores, settings: Mapping[str, object]) -> ConfidenceInterval | None:
    """Average over all points with these settings and over seeds; the interval is over seeds."""
    points = [p for p, own in of.settings.items() if all(own[key] == value for key, value in settings.items())]
    by_seed: dict[int, list[float]] = {}
    for point in points:
        for seed, value in of.values[point].items():
            by_seed.setdefault(seed, []).append(value)
    means = [float(np.mean(values)) for _, values in sorted(by_seed.items())]
    return interval(np.array(means)) if means else None


def _points(of: Scores, key: str) -> dict[str, Any]:
    there = [point for point, values in sorted(of.values.items()) if values]
    return {
        "x": [of.settings[point][key] for point in there],
        "y": [float(np.mean(list(of.values[point].values()))) for point in there],
        "mode": "markers",
        "marker": {"color": palette.ESTIMATE, "size": 5, "opacity": 0.7},
    }


def _table(rows: Sequence[Standing], keys: Sequence[str]) -> str:
    head = "".join(f'<th class="number">{html.escape(key)}</th>' for key in keys)
    head += "".join(f'<th class="number">{name}</th>' for name in ("mean", "95 %", "over the best", "runs", "failed"))
    body = "".join(
        "<tr>"
        + "".join(f'<td class="number">{html.escape(_short(row.settings[key]))}</td>' for key in keys)
        + f'<td class="number">{"–" if row.value is None else f"{row.value.mean:.4g}"}</td>'
        + f'<td class="number">{span(row.value)}</td><td class="number">{difference(row.over_best)}</td>'
        + f'<td class="number">{row.runs}</td><td class="number">{row.failed or ""}</td></tr>'
        for row in rows
    )
    table = f'<div class="scroll"><table><tr>{head}</tr>{body}</table></div>'
    return f'<section class="panel wide"><h2>The best points</h2>{table}</section>'


def _short(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
