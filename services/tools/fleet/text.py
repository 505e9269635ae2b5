"""Text table of fleet trials."""

from __future__ import annotations

from collections.abc import Sequence

from services.tools.fleet.trial import Row
from sim.evaluation.summary import Quantiles

HEADINGS = (
    "vehicles", "plans/s", "missed", "latency ms", "cycle ms", "off m", "core each", "controllers", "plants", "router",
    "first limit",
)  # fmt: skip

LEGEND = """missed     estimates without a plan of their own in time
latency    from an estimate's validity to its plan at the actuators; cycle: of one controller; both median / p99
off        mean distance from the point to hold
core each  processor time of one vehicle's controller, share of a core; then that of whole processes"""


def text(rows: Sequence[Row]) -> str:
    """Format a line for each trial, and a legend of the columns."""
    lines = [HEADINGS, *(_cells(row) for row in rows)]
    widths = [max(len(line[i]) for line in lines) for i in range(len(HEADINGS))]
    shown = ["  ".join(cell.rjust(width) for cell, width in zip(line, widths, strict=True)) for line in lines]
    return "\n".join([*shown, "", LEGEND])


def _cells(row: Row) -> tuple[str, ...]:
    return (
        str(row.vehicles),
        f"{row.plans / row.seconds:.0f}",
        f"{100 * row.missed_share:.1f} %",
        _pair(row.latency_ms),
        _pair(row.cycle_ms),
        f"{row.mean_error_m:.3f}",
        f"{100 * row.controller_busy_per_vehicle:.2f} %",
        *(f"{100 * row.busy[name]:.0f} %" for name in ("controllers", "plants", "router")),
        row.limit,
    )


def _pair(of: Quantiles) -> str:
    return "-" if of.median is None or of.p99 is None else f"{of.median:.1f} / {of.p99:.1f}"
