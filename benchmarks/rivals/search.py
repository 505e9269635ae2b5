"""One search for all: the same budget of trials whatever is tuned.

The first half of the budget is a scrambled Sobol sequence over the logarithms of the ranges; the second half draws
around the best so far, from a Gaussian whose width shrinks from a quarter to a fortieth of each range.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import qmc

from ltv_mpc.messages import Array

WIDTH, LEAST = 0.25, 0.025
BATCH = 4
"""Trials that are drawn around the same best."""


class Span(NamedTuple):
    """A number between two positive ones, by its logarithm."""

    low: float
    high: float


class Found(NamedTuple):
    """Best trial of a search."""

    values: dict[str, float]
    cost: float


def search(
    spans: dict[str, Span],
    costs: Callable[[Sequence[dict[str, float]]], Sequence[float]],
    *,
    budget: int,
    seed: int,
) -> Found:
    """Search for the best trial; ``costs`` returns the cost of each of some trials, and NaN counts as infinite."""
    names, rng = list(spans), np.random.default_rng(seed)
    low, high = np.log([spans[name] for name in names]).T
    tried: list[tuple[float, Array]] = []

    def judge(shares: Array) -> None:
        trials = [dict(zip(names, np.exp(low + share * (high - low)).tolist(), strict=True)) for share in shares]
        for share, cost in zip(shares, costs(trials), strict=True):
            tried.append((cost if np.isfinite(cost) else np.inf, share))

    judge(qmc.Sobol(len(names), scramble=True, rng=rng).random(budget // 2))
    while len(tried) < budget:
        best = min(tried, key=lambda one: one[0])[1]
        gone = (len(tried) - budget // 2) / max(1, budget - budget // 2)
        width = WIDTH * (LEAST / WIDTH) ** gone
        count = min(BATCH, budget - len(tried))
        judge((best + width * rng.standard_normal((count, len(names)))).clip(0.0, 1.0))
    cost, share = min(tried, key=lambda one: one[0])
    values = dict(zip(names, np.exp(low + share * (high - low)).tolist(), strict=True))
    return Found(values, cost)
