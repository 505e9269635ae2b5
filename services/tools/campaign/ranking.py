"""Ranking of a campaign's points: means over seeds with intervals, and differences paired by seed.

mean        of a figure over a point's seeds
interval    95 %, percentile bootstrap over seeds (Efron & Tibshirani 1993, ch. 13), 2000 resamples, seeded
difference  to another point: of the same seeds, whose water and noises are the same, so that what they have in common
            drops out; its interval likewise
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import msgspec
import numpy as np

from ltv_mpc.errors import one_line
from ltv_mpc.messages import Array
from services.tools.campaign.trial import Row

RESAMPLES = 2000
CONFIDENCE = 0.95
MAX_FAILURES = 5

HEAD = ("mean", "95 %", "over the best", "runs", "failed")
"""Head of the table of points, behind the varied keys."""


class ConfidenceInterval(msgspec.Struct, frozen=True, kw_only=True):
    """Mean with its 95 % interval; a single value has no interval."""

    mean: float
    low: float | None
    high: float | None


class Standing(msgspec.Struct, frozen=True, kw_only=True):
    """Rank entry of one point of the design."""

    point: int
    settings: dict[str, bool | int | float | str]
    runs: int
    failed: int
    value: ConfidenceInterval | None  # of the figure; None where no run has it
    over_best: ConfidenceInterval | None = None  # by how much it is larger than the best point's; None: its own


class Scores(NamedTuple):
    """Values of a figure by point and seed."""

    values: dict[int, dict[int, float]]
    settings: dict[int, dict[str, bool | int | float | str]]
    failed: dict[int, int]


def scores(rows: Iterable[Row], figure: str, keys: Iterable[str]) -> Scores:
    """Collect a figure by point and seed from ``rows``, which have the columns point, seed, failed, figure and keys."""
    keys = tuple(keys)
    made = Scores({}, {}, {})
    for row in rows:
        point = row["point"]
        made.settings.setdefault(point, {key: row[key] for key in keys})
        made.values.setdefault(point, {})
        made.failed.setdefault(point, 0)
        if row.get(figure) is None:
            made.failed[point] += 1
        else:
            made.values[point][row["seed"]] = row[figure]
    return made


def ranked(of: Scores, most: int | None = None) -> list[Standing]:
    """Rank the points, the best first and those without any value last; ``most``: maximum number."""
    means = {point: float(np.mean(list(values.values()))) for point, values in of.values.items() if values}
    order = sorted(means, key=lambda point: (means[point], point))
    order += sorted(of.values.keys() - means.keys())
    best = of.values[order[0]] if order else {}
    return [_standing(of, point, best if point != order[0] else None) for point in order[:most]]


def _standing(of: Scores, point: int, best: Mapping[int, float] | None) -> Standing:
    values = of.values[point]
    paired = [values[seed] - best[seed] for seed in sorted(values.keys() & best.keys())] if best else []
    return Standing(
        point=point,
        settings=of.settings[point],
        runs=len(values) + of.failed[point],
        failed=of.failed[point],
        value=interval(np.array([values[seed] for seed in sorted(values)])) if values else None,
        over_best=interval(np.array(paired)) if paired else None,
    )


def interval(values: Array) -> ConfidenceInterval:
    """Compute the mean and interval of values (K,), K >= 1; the same values give the same result."""
    mean = float(values.mean())
    if len(values) < 2:
        return ConfidenceInterval(mean=mean, low=None, high=None)
    drawn = np.random.default_rng(0).integers(0, len(values), (RESAMPLES, len(values)))
    low, high = np.quantile(values[drawn].mean(axis=1), [0.5 - CONFIDENCE / 2, 0.5 + CONFIDENCE / 2])
    return ConfidenceInterval(mean=mean, low=float(low), high=float(high))


def cells(of: Standing) -> list[str]:
    """Return the row of a point in the table: the values of its keys, and the columns of ``HEAD``."""
    settings = [f"{value:.4g}" if isinstance(value, float) else one_line(str(value)) for value in of.settings.values()]
    mean = "-" if of.value is None else f"{of.value.mean:.4g}"
    over = "" if of.over_best is None else f"{of.over_best.mean:+.3g} ({_span(of.over_best)})".removesuffix(" ()")
    return [*settings, mean, _span(of.value), over, str(of.runs), str(of.failed or "")]


def _span(of: ConfidenceInterval | None) -> str:
    """Format the limits of an interval."""
    return "" if of is None or of.low is None or of.high is None else f"{of.low:.3g} to {of.high:.3g}"


def failures(rows: Sequence[Row]) -> list[str]:
    """List the most frequent reasons why runs failed, with count and an example point and seed."""
    failed = [row for row in rows if row["failed"] is not None]
    count: Counter[str] = Counter(row["failed"] for row in failed)
    example = {row["failed"]: f"point {row['point']}, seed {row['seed']}" for row in reversed(failed)}
    lines = [f"{n} failed: {why} ({example[why]})" for why, n in count.most_common(MAX_FAILURES)]
    left = len(count) - len(lines)
    return [*lines, *([f"and {left} other reasons"] if left > 0 else [])]
