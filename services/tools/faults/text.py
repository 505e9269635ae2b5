"""Text report of a fault campaign: one line for each class, then the violated requirements."""

from __future__ import annotations

from services.runtime.console import counted
from services.tools.faults.fault import RECOVERED
from services.tools.faults.result import Campaign, Row, problems

MAX_SHOWN = 40
"""Faults for which a promise was not kept; all of them are in faults.json."""

HEAD = (
    f"{'fault':<20} {'n':>4} {'proc':>4} {'react s':>8} {'worst':>6} {'late':>4} {'error m':>8} {'ratio':>6} "
    f"{'>2':>3} {'moved m':>7} {'bound':>5} {'>':>2} {'unflagged':>9} {'lost':>4} {'bad':>3} {'out':>3}  "
    "limit of the reaction"
)


def table(of: Campaign) -> str:
    """Return the report of a campaign as text."""
    lines = [
        f"{counted(of.injected, 'fault')} in {counted(of.classes, 'class', 'classes')}, "
        f"{of.in_processes} of them in processes, seed {of.seed}, "
        f"{of.wall_s:.0f} s, load {of.load:.1f} a core{', quick' if of.quick else ''}",
        HEAD,
        *(_line(row) for row in of.rows),
        f"{of.uncontrolled_exits} uncontrolled exits, {of.bad_thrusts} bad thrusts, {of.uncounted_losses} uncounted "
        f"losses, {of.late_reactions} late reactions, {of.not_recovered} not recovered, {of.beyond_bound} "
        f"beyond their bound, {of.unflagged} errors unflagged",
    ]
    if of.window_chance is not None:
        lines.append(
            f"by the same half minute alone {of.window_over} of {of.window_asked} would be over "
            f"{RECOVERED:g}; by chance {100.0 * of.window_chance:.0f} % are, without any fault"
        )
    for seen in of.violations[:MAX_SHOWN]:
        fault = seen.fault
        where = f"{fault.kind} {fault.target}, {seen.place}, seed {seen.run_seed}"
        when = f"{fault.start_s:.1f} to {fault.end_s:.1f} s, size {fault.size:.3g}"
        lines.append(f"requirement failed: {where}, {when}: {'; '.join(problems(seen))}")
    if len(of.violations) > MAX_SHOWN:
        lines.append(f"requirement failed: {len(of.violations) - MAX_SHOWN} more")
    return "\n".join(lines)


def _line(row: Row) -> str:
    return (
        f"{row.fault:<20} {row.injected:>4} {row.in_processes:>4} {_figure(row.reaction_median_s, 8, 2)} "
        f"{_figure(row.reaction_worst_s, 6, 2)} {row.late:>4} {_figure(row.worst_error_m, 8, 2)} "
        f"{_figure(row.worst_ratio, 6, 1)} {row.not_recovered:>3} "
        f"{_figure(row.grown_m, 7, 2)} {_figure(row.bound_m, 5, 0)} {row.beyond_bound:>2} {row.unflagged:>9} "
        f"{row.uncounted:>4} {row.bad_thrusts:>3} {row.uncontrolled:>3}  {row.limit}"
    )


def _figure(value: float | None, width: int, places: int) -> str:
    return f"{'-':>{width}}" if value is None else f"{value:>{width}.{places}f}"
