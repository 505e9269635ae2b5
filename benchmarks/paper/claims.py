"""Claims of the paper's figures as numbers over many seeds, each of them a full loop with localisation."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from benchmarks.batch import in_order
from benchmarks.page_tables import Table
from benchmarks.paper.settings import RECORDED, Variant
from benchmarks.paper.sheets import NONE, OURS_LONG, OURS_SHORT, PAPER_LONG, PAPER_SHORT
from ltv_mpc import Run, simulate

SIGMAS = 2.0


class Descent(NamedTuple):
    """Figures of one descent of one seed."""

    tracking_m: float  # mean distance of the estimate from the line
    saturated: float  # share of the time with a lateral thruster at its bound
    true_within: float  # share of the axes on which the vehicle ended within 2 sigma of the localisation
    current_within: float  # share of the current errors within their 2 sigma, at the end, where the vehicle has been


class Seed(NamedTuple):
    """Descent to run."""

    variant: Variant
    seed: int
    duration_s: float


def descend(one: Seed) -> Descent:
    """Run a descent and return its figures."""
    tables: dict[str, dict[str, object]] = {}
    for text in one.variant.overrides:
        table, _, rest = text.partition(".")
        key, _, value = rest.partition("=")
        tables.setdefault(table, {})[key] = float(value)
    run = simulate(one.variant.scenario, seed=one.seed, duration_s=one.duration_s, **tables)
    return Descent(
        run.summary["tracking_error_m"]["mean"],
        run.summary["thrust"]["saturated_fraction"],
        _true_within(run),
        _current_within(run),
    )


def _true_within(run: Run) -> float:
    """Return the share of north and east on which the final distance from the line is within the drift's 2 sigma.

    The line begins at the estimate at t = 0, so the distance is that of the vehicle since then.
    """
    truth, estimate = run["world/truth"], run["estimate"]
    true, begun = truth["position_m"][:, :2], int(np.searchsorted(truth["t_ns"], 0))
    first = int(np.searchsorted(estimate["t_ns"], 0))
    grown = estimate["covariance"][-1, :2, :2] - estimate["covariance"][first, :2, :2]
    moved = true[-1] - true[begun]
    return float(np.mean(np.abs(moved) <= SIGMAS * np.sqrt(np.diag(grown).clip(0.0))))


def _current_within(run: Run) -> float:
    estimate, truth = run["estimate"], run["world/truth"]
    depth, sd = estimate["current.depth_m"][-1], estimate["current.sd_mps"][-1]
    true_depth = truth["position_m"][:, 2]
    been = depth <= true_depth.max()
    order = np.argsort(true_depth)
    within = []
    for axis, name in enumerate(("north", "east")):
        actual = np.interp(depth, true_depth[order], truth["current_mps"][order, axis])
        within.append(np.abs(estimate[f"current.{name}_mps"][-1] - actual)[been] <= SIGMAS * sd[been])
    return float(np.mean(within))


def over_seeds(seeds: int, duration_s: float, *, workers: int | None) -> dict[str, list[Descent]]:
    """Run seeds 0 to ``seeds`` - 1 of each recorded variant but the default; return them by the variant's key."""
    flown = in_order(
        descend,
        [Seed(variant, seed, duration_s) for variant in RECORDED[:-1] for seed in range(seeds)],
        workers=workers,
    )
    return {variant.key: flown[i * seeds : (i + 1) * seeds] for i, variant in enumerate(RECORDED[:-1])}


def table(found: Mapping[str, Sequence[Descent]]) -> Table:
    """Tabulate each claim with its share or mean, for the paper's cost and delays and for this project's."""
    seeds = len(found[NONE])
    papers, ours = (NONE, PAPER_SHORT, PAPER_LONG), (NONE, OURS_SHORT, OURS_LONG)

    def better(which: Sequence[str], a: int, b: int) -> float:
        pairs = zip(found[which[a]], found[which[b]], strict=True)
        return 100.0 * sum(x.tracking_m < y.tracking_m for x, y in pairs) / seeds

    def mean(of: Callable[[Descent], float], key: str) -> float:
        return statistics.fmean(map(of, found[key]))

    def saturated(which: Sequence[str], a: int) -> float:
        return 100.0 * mean(lambda one: one.saturated, which[a])

    rows: list[tuple[str | float | None, ...]] = [
        (name, claim, *(of(which) for which in (papers, ours)))
        for name, claim, of in (
            ("6, 7", "tracking error without control (m)", lambda w: mean(lambda one: one.tracking_m, w[0])),
            ("6, 7", "at 2.5 s (m)", lambda w: mean(lambda one: one.tracking_m, w[1])),
            ("6, 7", "at 5 s (m)", lambda w: mean(lambda one: one.tracking_m, w[2])),
            ("6, 7", "5 s better than 2.5 s (% of seeds)", lambda w: better(w, 2, 1)),
            ("6, 7", "2.5 s better than no control (% of seeds)", lambda w: better(w, 1, 0)),
            ("6, 7", "5 s better than no control (% of seeds)", lambda w: better(w, 2, 0)),
            ("8", "saturated at 2.5 s (% of the time)", lambda w: saturated(w, 1)),
            ("9", "saturated at 5 s (% of the time)", lambda w: saturated(w, 2)),
            (
                "10",
                "5 s: vehicle ends within 2 sigma of the localisation (% of north and east)",
                lambda w: 100.0 * mean(lambda one: one.true_within, w[2]),
            ),
            (
                "11",
                "5 s: error of the current within its 2 sigma (% of depths, north and east)",
                lambda w: 100.0 * mean(lambda one: one.current_within, w[2]),
            ),
        )
    ]
    return Table(
        name="claims",
        head=("figure", f"mean of seeds 0 to {seeds - 1}", "the paper's cost and delays", "this project's"),
        digits=(0, 0, 2, 2),
        rows=tuple(rows),
    )
