"""Terminal output of a campaign: table of the best points, and the failures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from rich.table import Table
from rich.text import Text

from ltv_mpc.errors import one_line
from services.tools.campaign.ranking import ConfidenceInterval, Standing
from services.tools.campaign.trial import Row

SHOWN = 10
MAX_FAILURES = 5


def standings(rows: Sequence[Standing], figure: str) -> Table:
    """Tabulate the best points."""
    table = Table(title=_shown(f"{figure}, mean over seeds with 95 % interval"), title_justify="left", box=None)
    keys = list(rows[0].settings) if rows else []
    for key in keys:
        table.add_column(_shown(key.rpartition(".")[2]), justify="right")
    for name in ("mean", "interval", "over the best", "runs"):
        table.add_column(name, justify="right")
    for row in rows:
        values = [_value(row.settings[key]) for key in keys]
        runs = f"{row.runs}" + (f", {row.failed} failed" if row.failed else "")
        mean = "-" if row.value is None else f"{row.value.mean:.4g}"
        table.add_row(*values, mean, span(row.value), difference(row.over_best), runs)
    return table


def span(of: ConfidenceInterval | None) -> str:
    """Format the limits of an interval."""
    return "" if of is None or of.low is None or of.high is None else f"{of.low:.3g} to {of.high:.3g}"


def difference(of: ConfidenceInterval | None) -> str:
    """Format a difference with its interval."""
    return "" if of is None else f"{of.mean:+.3g}" + (f" ({span(of)})" if span(of) else "")


def failures(rows: Sequence[Row]) -> list[str]:
    """List the most frequent reasons why runs failed, with count and an example point and seed."""
    count: Counter[str] = Counter(row["failed"] for row in rows)
    example = {row["failed"]: f"point {row['point']}, seed {row['seed']}" for row in reversed(rows)}
    lines = [f"{n} failed: {why} ({example[why]})" for why, n in count.most_common(MAX_FAILURES)]
    left = len(count) - len(lines)
    return [*lines, *([f"and {left} other reasons"] if left > 0 else [])]


def _value(value: object) -> Text:
    return _shown(f"{value:.4g}" if isinstance(value, float) else str(value))


def _shown(text: str) -> Text:
    return Text(one_line(text))
