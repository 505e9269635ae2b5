"""Run report, report.html: plots, figures and events of a run in one file that needs no network.

Several runs are overlaid, with a table that compares their figures. The plotted data are decimated so that the file
stays below 8 MB, of which plotly takes 5 MB.
"""

from __future__ import annotations

import html
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from services.recording.info import utc
from services.recording.node_settings import SCENARIO, table_of, vehicle_name
from services.recording.writer import VEHICLE_MODE
from services.reporting import differences, static_files
from services.reporting.assessment import assessment
from services.reporting.html_table import NUMBER, Cell, row, table
from services.reporting.plots import palette
from services.reporting.plots.catalogue import PLOTS, REVIEW
from services.reporting.plots.collector import ROWS
from services.reporting.plots.description import NO_DATA, Group, Plot, Series
from services.reporting.plots.recorded import PlotData, read
from services.reporting.plots.table import Columns
from services.reporting.run_summary_text import failure, how
from services.reporting.safety import Mood
from services.run.folder import draft_of

MAX_RUNS = 40
ROWS_OF_ALL = 4 * ROWS
"""Rows of one table, summed over all runs: a report of many runs is no larger than one of a few."""

_CODE = r"<code>\1</code>"


class Run(msgspec.Struct, frozen=True, kw_only=True):
    """Run to be reported: name, recording and the contents of summary.json (empty if there is none)."""

    name: str
    recording: Path
    summary: Mapping[str, Any]


def write(runs: Sequence[Run], out: Path) -> list[differences.Row]:
    """Write the report, completely or not at all, and return the figures in it.

    Raises ``NoPlotly``, ``ConfigError`` if a file is not a recording, and ``OSError``.
    """
    static_files.plotly_path()  # before the recordings are read
    plot_data = [read(run.recording, rows=min(ROWS, ROWS_OF_ALL // len(runs))) for run in runs]
    figures = differences.rows([run.summary for run in runs])
    title = f"{runs[0].name}" if len(runs) == 1 else f"{len(runs)} runs"
    parts = {
        "lines": "\n".join(_lines(runs, plot_data)),
        "safe": _safety([run.name for run in runs], plot_data),
        "tables": "\n".join(_tables(runs, plot_data, figures)),
    }
    _write_page(out, title, plots_with_data(plot_data), _shown(runs, plot_data), **parts)
    return figures


def write_plots(
    out: Path,
    title: str,
    plots: Sequence[Plot],
    tables: Mapping[str, Columns],
    *,
    values: Mapping[str, float] | None = None,
    lines: str = "",
    below: str = "",
) -> None:
    """Write a page of the plots of one result, drawn as those of a run. Raises ``NoPlotly`` and ``OSError``.

    ``values`` are those of levels; ``lines`` and ``below`` are HTML under the title and under the plots.
    """
    shown = {"name": title, "colour": None, "tables": tables, "values": values or {}, "marks": ()}
    _write_page(out, title, plots, [shown], lines=lines, safe="", tables=below)


def _write_page(out: Path, title: str, plots: Sequence[Plot], runs: Sequence[Mapping[str, Any]], **parts: str) -> None:
    """Write a page, whose data for report.js are JSON in which no HTML tag can start."""
    plotly, script = static_files.report_scripts()
    data = msgspec.json.encode({"plots": plots, "runs": runs, "dark": palette.DARK}).decode().replace("<", "\\u003c")
    style = static_files.text("style.css") + static_files.text("report.css")
    page = {"title": html.escape(title), "style": style, "plotly": plotly, "data": data, "script": script}
    text = static_files.filled(static_files.text("report.html"), **page, **parts)
    with draft_of(out) as draft:
        draft.write_text(text, encoding="utf-8")


def _shown(runs: Sequence[Run], plot_data: Sequence[PlotData]) -> list[dict[str, Any]]:
    """Return the data of each run for report.js."""
    several = len(runs) > 1
    return [
        {
            "name": run.name,
            "colour": palette.RUNS[i % len(palette.RUNS)] if several else None,
            "tables": data.tables,
            "values": data.values,
            "marks": data.marks,
        }
        for i, (run, data) in enumerate(zip(runs, plot_data, strict=True))
    ]


def plots_with_data(plot_data: Sequence[PlotData]) -> list[Plot]:
    """Return the plots for which a run has data, each with the series that have some.

    A plot that says itself why it is empty stays, if its run is a simulation. Surface craft have no plots of depth.
    """
    plots = []
    only_surface = all(_is_surface_craft(data) for data in plot_data)
    for plot in (*PLOTS, *REVIEW):
        if plot.diving and only_surface:
            continue
        series = [part for part in plot.series if any(_has_data(data, part) for data in plot_data)]
        simulated = any(data.metadata.get("mode") != VEHICLE_MODE for data in plot_data)
        if series or (simulated and plot.empty != NO_DATA):
            levels = tuple(level for level in plot.levels if any(level.value in data.values for data in plot_data))
            plots.append(msgspec.structs.replace(plot, series=tuple(series) or plot.series, levels=levels))
    return plots


def _is_surface_craft(data: PlotData) -> bool:
    """Return True if the known thrusters have no vertical one; without a vehicle file, if there is no depth."""
    if "port_max_N" in data.values:
        return "vertical_max_N" not in data.values
    return not any(depth_m is not None for depth_m in data.tables["track"].get("depth_m", ()))


def _has_data(data: PlotData, series: Series) -> bool:
    return any(value is not None for value in data.tables[series.table].get(series.y, ()))


def _lines(runs: Sequence[Run], plot_data: Sequence[PlotData]) -> list[str]:
    """Return the lines below the title: one for each run, and for a single one what its figures mean."""
    lines = []
    for run, data in zip(runs, plot_data, strict=True):
        if failed := failure(run.summary):
            lines.append(f'<p class="bad">{html.escape(failed)}</p>')
        words = [_vehicle(data)] if data.metadata.get("mode") == VEHICLE_MODE else [_how(run.summary, data.metadata)]
        if data.cut:
            words.append('<span class="bad">the recording was cut off: the report shows its readable part</span>')
        found = [html.escape(sentence) for sentence in assessment(run.summary)] if run.summary else []
        if len(runs) > 1:  # of several, what the first sentence says: how far the vehicle was from the reference
            words += found[:1]
        name = f"{html.escape(run.name)}: " if len(runs) > 1 else ""
        lines.append(f"<p>{name}{' · '.join(words)}</p>")
        if len(runs) == 1 and found:
            lines.append(f'<p class="found">{re.sub("`([^`]*)`", _CODE, " ".join(found))}</p>')
    return lines


def _how(summary: Mapping[str, Any], metadata: Mapping[str, str]) -> str:
    """Describe the mode of the run and its seed; beside a vehicle its name and the start by its clock."""
    ran = ", ".join(filter(None, (_scenario(metadata), how({"mode": metadata.get("mode"), **summary}))))
    seed = summary.get("seed", metadata.get("seed"))
    return html.escape(f"{ran}, seed {seed}" if seed is not None else ran)


def _scenario(metadata: Mapping[str, str]) -> str:
    """Return the title of the scenario and the name of the vehicle; empty if the recording does not hold them."""
    title = table_of(metadata, SCENARIO).get("title", "")
    return ", ".join(filter(None, (str(title), f"vehicle {name}" if (name := vehicle_name(metadata)) else "")))


def _vehicle(data: PlotData) -> str:
    """Name the vehicle and the start of the recording by its clock, from which all times count."""
    start = utc(data.start_s) or f"{data.start_s:.3f} s"
    return html.escape(f"vehicle {vehicle_name(data.metadata)}, times from {start} by its own clock")


def _tables(runs: Sequence[Run], plot_data: Sequence[PlotData], figures: Sequence[differences.Row]) -> list[str]:
    sections = [_figures(runs, figures)] if figures else []
    if len(runs) > 1:
        return sections + [_events(run, data) for run, data in zip(runs, plot_data, strict=True)]
    files = plot_data[0].metadata
    if SCENARIO in files:
        return [*sections, _file(f"{SCENARIO}: every setting and the program versions", files[SCENARIO])]
    return sections + [_file(name, text) for name, text in files.items() if name.startswith("config/")]


def _file(title: str, text: str) -> str:
    summary = f"<details><summary>{html.escape(title)}</summary>"
    return f'<section class="panel wide">{summary}<pre>{html.escape(text)}</pre></details></section>'


def _figures(runs: Sequence[Run], figures: Sequence[differences.Row]) -> str:
    names = ["value"] if len(runs) == 1 else [run.name for run in runs]
    content = table("Results", differences.table(names, figures), numbers=True)
    return f'<section id="figures" class="panel{" wide" if len(runs) > 1 else ""}"><h3>Results</h3>{content}</section>'


def _events(run: Run, data: PlotData) -> str:
    title, head = f"Events of {run.name}", (("time (s)", NUMBER), "process", "what happened")
    content = table(title, [head, *_event_rows(data)], frame="scroll events")
    return f'<section class="panel"><h3>{html.escape(title)}</h3>{content}</section>'


def _safety(names: Sequence[str], plot_data: Sequence[PlotData]) -> str:
    """Return the part that answers whether the run was safe; of several runs a table with a column each."""
    if len(names) > 1:
        return _of_several(names, plot_data)
    (data,) = plot_data
    facts = "".join(
        f'<div><dt>{html.escape(fact.name)}</dt><dd class="{fact.mood}">{html.escape(fact.text)}</dd></div>'
        for fact in data.safety.facts()
    )
    return static_files.safe_part(
        facts=facts,
        processes=_processes(data),
        events="".join(map(row, _event_rows(data))),
        sortable=' class="sortable"',
    )


def _processes(data: PlotData) -> str:
    """Return the rows of the table of processes."""
    rows = "".join(
        row(
            (
                one.name,
                f"{one.state}{f', started {one.starts} times' if one.starts > 1 else ''}",
                ("-" if one.step_us is None else f"{one.step_us:.0f}", NUMBER),
                (str(one.lost), f"{NUMBER} bad" if one.lost else NUMBER),
            )
        )
        for one in data.safety.processes()
    )
    in_lock_step = data.metadata.get("mode") == "lockstep"
    why = "none: lock step runs in one process" if in_lock_step else "no status in the recording"
    return rows or f'<tr><td colspan="4" class="quiet">{why}</td></tr>'


def _of_several(names: Sequence[str], plot_data: Sequence[PlotData]) -> str:
    """Return the facts about several runs, and the sum of the messages that their processes lost."""
    columns = []
    for data in plot_data:
        facts = {fact.name: (fact.text, fact.mood) for fact in data.safety.facts()}
        if processes := data.safety.processes():
            lost = sum(one.lost for one in processes)
            facts["messages lost"] = (str(lost), Mood.BAD if lost else Mood.GOOD)
        columns.append(facts)
    every = dict.fromkeys(name for facts in columns for name in facts)
    rows = [("fact", *names), *((name, *(facts.get(name, "-") for facts in columns)) for name in every)]
    content = table("Safety", rows, kind="facts")
    return f'<section class="part"><h2>{Group.SAFE.value}</h2><div class="panel">{content}</div></section>'


def _event_rows(data: PlotData) -> list[tuple[Cell, ...]]:
    rows: list[tuple[Cell, ...]] = [((f"{mark.t_s:.1f}", NUMBER), mark.node, mark.text) for mark in data.marks]
    if data.omitted_marks or not rows:
        rows.append(("", "", (f"and {data.omitted_marks} more" if rows else "no events", "quiet")))
    return rows
