"""Part "Is it safe?" of the report: facts, processes and events, as the live page has them."""

from __future__ import annotations

import html
from collections.abc import Sequence

from services.reporting import static_files
from services.reporting.html_table import NUMBER, Cell, number, row, table
from services.reporting.plots.description import Group
from services.reporting.plots.recorded import PlotData
from services.reporting.safety import Mood


def part(names: Sequence[str], plot_data: Sequence[PlotData]) -> str:
    """Return the part that answers whether the run was safe; of several runs a table with a column each."""
    if len(names) > 1:
        return _of_several(names, plot_data)
    (data,) = plot_data
    facts = "".join(
        f'<div><dt>{html.escape(fact.name)}</dt><dd class="{fact.mood}">{html.escape(fact.text)}</dd></div>'
        for fact in data.safety.facts()
    )
    return static_files.safe_part(
        facts=facts, processes=_processes(data), events=event_rows(data), sortable=' class="sortable"'
    )


def _processes(data: PlotData) -> str:
    """Return the rows of the table of processes."""
    rows = "".join(
        row(
            (
                one.name,
                f"{one.state}{f', started {one.starts} times' if one.starts > 1 else ''}",
                number(one.step_us, 0),
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
    body = "".join(row((name, *(facts.get(name, "–") for facts in columns))) for name in every)
    content = table("Safety", ("fact", *names), body, kind="facts")
    return f'<section class="part"><h2>{Group.SAFE.value}</h2><div class="panel">{content}</div></section>'


def event_rows(data: PlotData) -> str:
    """Return the rows of the table of events."""
    rows: list[tuple[Cell, ...]] = [((f"{mark.t_s:.1f}", NUMBER), mark.node, mark.text) for mark in data.marks]
    if data.omitted_marks or not rows:
        rows.append(("", "", (f"and {data.omitted_marks} more" if rows else "no events", "quiet")))
    return "".join(map(row, rows))
