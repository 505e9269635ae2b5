"""Which horizon, when: the map of docs/horizon.md, from the two campaigns that ``make map`` runs.

    .venv/bin/python -m benchmarks.horizon_map --known DIR --realistic DIR [--figures DIR] [--out FILE.json]

At each place of the design (a current, a descent, a vehicle, a delay) the same waters are flown with several horizons.
What is enough there is the shortest horizon whose mean error is within 10 % of the best one's. Places are compared in
the vehicle's own speed V and time T (``ltv_mpc/control/scales.py``), by four groups without a dimension:

    strength    sd / V              how strong the current is
    layer       l / (w T)           how long the vehicle takes to sink through one correlation length
    change      q sqrt(T) / V       how much the current changes while the vehicle turns, q in m/s per sqrt(s)
    delay       D / T

Four groups    log(H / T) = a0 + a1 log strength + a2 log layer + a3 change + a4 delay    by least squares. It is judged
on places that it was not fitted to (eight folds): by how much the error at its horizon exceeds that at the best one,
beside the best H, the best H / T, and the H / T that is enough at nine of ten places: one for all.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow.parquet as pq

from ltv_mpc.control.scales import scales_of
from ltv_mpc.signals import Array
from services.campaign.campaign import BASE, Plan, reopened
from services.campaign.design import points
from services.campaign.trial import situation

HORIZON = "controller.horizon_s"
FIGURE = "true_error_m.mean"
ENOUGH = 1.1
FOLDS = 8
GROUPS = ("strength", "layer", "change", "delay")


class Place(NamedTuple):
    """One place of the design, all horizons."""

    time_s: float  # T of its vehicle
    groups: Array  # (4,), as GROUPS
    horizons_s: Array  # (H,)
    errors_m: Array  # (H,) mean over seeds

    @property
    def enough(self) -> int:
        """Which horizon is the shortest that is enough."""
        return int(np.argmax(self.errors_m <= ENOUGH * self.errors_m.min()))

    def excess(self, horizon_s: float) -> float:
        """By how much the error at the nearest horizon of the design exceeds the best one's; 0.1 is 10 %."""
        i = int(np.argmin(np.abs(np.log(self.horizons_s / horizon_s))))
        return float(self.errors_m[i] / self.errors_m.min() - 1.0)


def places(folder: Path) -> list[Place]:
    """Those of a campaign's folder of which every horizon and seed is there."""
    campaign = reopened(folder)
    files = [path for path in (folder / BASE).rglob("*") if path.is_file()]
    base = tuple(sorted((str(path.relative_to(folder / BASE)), path.read_text()) for path in files))
    made = Plan(campaign, base, points(campaign), {})
    errors: dict[int, list[float]] = {}
    for path in sorted((folder / "parts").glob("*.parquet")):
        for row in pq.read_table(path, columns=["point", FIGURE]).to_pylist():
            if row[FIGURE] is not None:
                errors.setdefault(row["point"], []).append(row[FIGURE])
    horizons = np.array(campaign.cross[HORIZON], dtype=np.float64)
    found = []
    for first in range(0, len(made.points), len(horizons)):
        of = [errors.get(first + k, []) for k in range(len(horizons))]
        if any(len(runs) < campaign.seeds.count for runs in of):
            continue
        point = made.points[first]
        here = situation(base, made.settings(point), made.factors(point), campaign.seeds.first)
        scales = scales_of(here.vehicle)
        water, V, T = here.scenario.water, scales.speed_mps, scales.time_s
        rate = here.reference.descent_rate_mps
        groups = np.array(
            [
                water.sd_mps / V,
                water.correlation_length_m / (rate * T),
                water.change_mps_per_rts * math.sqrt(T) / V,
                here.scenario.run.compute_delay_s / T,
            ]
        )
        found.append(Place(T, groups, horizons, np.array([np.mean(runs) for runs in of])))
    return found


def features(groups: Array) -> Array:
    """(K, 5) of groups (K, 4)."""
    strength, layer, change, delay = groups.T
    return np.column_stack([np.ones(len(groups)), np.log(strength), np.log(layer), change, delay])


def fitted(of: Sequence[Place]) -> Array:
    """a0 .. a4."""
    X = features(np.array([place.groups for place in of]))
    y = np.array([math.log(place.horizons_s[place.enough] / place.time_s) for place in of])
    found: Array = np.linalg.lstsq(X, y, rcond=None)[0]
    return found


def by_rule(a: Array, place: Place) -> float:
    """Horizon (s)."""
    return float(place.time_s * math.exp(float(features(place.groups[None])[0] @ a)))


def judged(of: Sequence[Place]) -> dict[str, Any]:
    """Excess of the rule and of constants at places that they were not fitted to."""
    folds = np.arange(len(of)) % FOLDS
    names = ("four groups", "best H", "best H / T", "H / T enough at nine of ten", "5 s")
    excess: dict[str, list[float]] = {name: [] for name in names}
    for fold in range(FOLDS):
        known = [place for place, k in zip(of, folds, strict=True) if k != fold]
        a = fitted(known)
        constant, ratio = _best(known, _constants(known)), _best(known, RATIOS)
        enough = float(np.quantile(_in_own_time(known), 0.9))
        for place, k in zip(of, folds, strict=True):
            if k == fold:
                for name, horizon_s in zip(
                    names,
                    (by_rule(a, place), constant, ratio * place.time_s, enough * place.time_s, 5.0),
                    strict=True,
                ):
                    excess[name].append(place.excess(horizon_s))
    return {
        name: {"median": float(np.median(x)), "p90": float(np.quantile(x, 0.9)), "worst": float(np.max(x))}
        for name, x in excess.items()
    }


RATIOS = tuple((float(q), lambda place, q=q: q * place.time_s) for q in np.geomspace(0.2, 4.0, 30))
"""Horizons that are so many times the vehicle's own time."""


def _constants(of: Sequence[Place]) -> list[tuple[float, Any]]:
    return [(float(h), lambda _, h=h: h) for h in of[0].horizons_s]


def _in_own_time(of: Sequence[Place]) -> Array:
    """What is enough at each place, over T."""
    return np.array([place.horizons_s[place.enough] / place.time_s for place in of])


def _best(known: Sequence[Place], candidates: Sequence[tuple[float, Any]]) -> float:
    """The candidate whose horizons exceed least in the mean."""
    return float(min(candidates, key=lambda one: np.mean([place.excess(one[1](place)) for place in known]))[0])


def summary(of: Sequence[Place]) -> dict[str, Any]:
    """What is kept."""
    relative = np.array([place.errors_m / place.errors_m.min() for place in of])
    return {
        "places": len(of),
        "horizons_s": of[0].horizons_s.tolist(),
        "enough": {str(h): int(sum(place.enough == i for place in of)) for i, h in enumerate(of[0].horizons_s)},
        "error_over_best": {
            str(h): {"median": float(np.median(relative[:, i])), "p90": float(np.quantile(relative[:, i], 0.9))}
            for i, h in enumerate(of[0].horizons_s)
        },
        "enough_over_T": {str(q): float(np.quantile(_in_own_time(of), q)) for q in (0.1, 0.5, 0.9)},
        "rule": dict(zip(("a0", *GROUPS), fitted(of).tolist(), strict=True)),
        "best_constant_H_s": _best(of, _constants(of)),
        "best_constant_H_over_T": _best(of, RATIOS),
        "excess_at_places_not_fitted_to": judged(of),
        "enough_s_by_third": _thirds(of),
    }


def _thirds(of: Sequence[Place]) -> dict[str, list[float]]:
    """Of each group: the median of what is enough (s) in its lowest, middle and highest third."""
    groups = np.array([place.groups for place in of])
    enough = np.array([place.horizons_s[place.enough] for place in of])
    made = {}
    for name, column in zip(GROUPS, groups.T, strict=True):
        order = np.argsort(column, kind="stable")
        made[name] = [float(np.median(enough[part])) for part in np.array_split(order, 3)]
    return made


def draw(maps: Mapping[str, Sequence[Place]], path: Path) -> None:
    """Error over the best one's against the horizon, by thirds of each group: rows of panels, one column a campaign."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(
        len(GROUPS), len(maps), figsize=(3.4 * len(maps), 8.6), sharex=True, sharey=True, squeeze=False
    )
    for j, (name, of) in enumerate(maps.items()):
        relative = np.array([place.errors_m / place.errors_m.min() for place in of])
        for i, group in enumerate(GROUPS):
            axis = axes[i][j]
            order = np.argsort([place.groups[i] for place in of], kind="stable")
            parts = zip(np.array_split(order, 3), ("lowest", "middle", "highest"), COLOURS, MARKERS, strict=True)
            for part, third, colour, marker in parts:
                median = np.median(relative[part], axis=0)
                axis.plot(of[0].horizons_s, median, color=colour, marker=marker, markersize=4, label=f"{third} third")
            axis.set_xscale("log")
            axis.set_yscale("log")
            axis.set_title(f"{name}: {group}", fontsize=9, loc="left")
            axis.grid(color="#e6e8eb")
            if j == 0:
                axis.set_ylabel("error / best")
            if i == len(GROUPS) - 1:
                axis.set_xlabel("horizon (s)")
                axis.set_xticks(of[0].horizons_s, [f"{h:g}" for h in of[0].horizons_s])
                axis.minorticks_off()
    axes[0][0].legend(fontsize=7, frameon=False)
    figure.tight_layout()
    figure.savefig(path, dpi=150)
    plt.close(figure)


COLOURS = ("#0072B2", "#D55E00", "#009E73")
MARKERS = ("o", "s", "^")


def main() -> None:
    """Read, fit, draw, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--known", type=Path)
    parser.add_argument("--realistic", type=Path)
    parser.add_argument("--figures", type=Path)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    folders = {"known state": options.known, "realistic": options.realistic}
    maps = {name: places(folder) for name, folder in folders.items() if folder is not None}
    maps = {name: of for name, of in maps.items() if len(of) >= 2 * FOLDS}
    if not maps:
        parser.error(f"no campaign with {2 * FOLDS} complete places is there yet")
    kept = {name: summary(of) for name, of in maps.items()}
    text = json.dumps(kept, indent=1)
    print(text)
    if options.out is not None:
        options.out.write_text(text + "\n")
    if options.figures is not None:
        draw(maps, options.figures / "horizon.png")


if __name__ == "__main__":
    main()
