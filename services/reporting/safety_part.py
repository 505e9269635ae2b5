"""Part "Is it safe?" of the report: facts, processes and events, as the live page has them."""

from __future__ import annotations

import html
from collections.abc import Sequence

from services.reporting import static_files
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
        f"<tr><td>{html.escape(one.name)}</td>"
        f"<td>{html.escape(one.state)}{f', started {one.starts} times' if one.starts > 1 else ''}</td>"
        f'<td class="number">{number(one.step_us, 0)}</td>'
        f'<td class="{"number bad" if one.lost else "number"}">{one.lost}</td></tr>'
        for one in data.safety.processes()
    )
    if rows:
        return rows
    why = (
        "none: lock step runs in one process"
        if data.metadata.get("mode") == "lockstep"
        else "no status in the recording"
    )
    return f'<tr><td colspan="4" class="quiet">{why}</td></tr>'


def _of_several(names: Sequence[str], plot_data: Sequence[PlotData]) -> str:
    """Return the facts about several runs, and the sum of the messages that their processes lost."""
    columns = []
    for data in plot_data:
        facts = {fact.name: (fact.mood, fact.text) for fact in data.safety.facts()}
        if processes := data.safety.processes():
            lost = sum(one.lost for one in processes)
            facts["messages lost"] = (Mood.BAD if lost else Mood.GOOD, str(lost))
        columns.append(facts)
    nothing = Mood.NEUTRAL, "–"
    body = "".join(
        f"<tr><td>{html.escape(name)}</td>"
        + "".join(
            f'<td class="{mood}">{html.escape(text)}</td>' for mood, text in (one.get(name, nothing) for one in columns)
        )
        + "</tr>"
        for name in dict.fromkeys(name for facts in columns for name in facts)
    )
    head = "".join(f"<th>{html.escape(name)}</th>" for name in names)
    table = f"<table><thead><tr><th>fact</th>{head}</tr></thead><tbody>{body}</tbody></table>"
    table = f'<div class="scroll" tabindex="0" role="region" aria-label="Safety">{table}</div>'
    return f'<section class="part"><h2>{Group.SAFE.value}</h2><div class="panel">{table}</div></section>'


def event_rows(data: PlotData) -> str:
    """Return the rows of the table of events."""
    body = "".join(
        f'<tr><td class="number">{mark.t_s:.1f}</td><td>{html.escape(mark.node)}</td>'
        f"<td>{html.escape(mark.text)}</td></tr>"
        for mark in data.marks
    )
    if data.omitted_marks:
        body += f'<tr><td></td><td></td><td class="quiet">and {data.omitted_marks} more</td></tr>'
    return body or '<tr><td></td><td></td><td class="quiet">no events</td></tr>'


def number(value: float | None, digits: int, *, signed: bool = False) -> str:
    """Return a figure of a table; a dash if there is none."""
    if value is None:
        return "–"
    return f"{value:+.{digits}f}" if signed else f"{value:.{digits}f}"
