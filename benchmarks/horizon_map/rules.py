"""Rules for the horizon, each judged at places that it was not fitted to (eight folds).

Four groups    log(H / T) = a0 + a1 log strength + a2 log layer + a3 change + a4 delay    by least squares
Constants      the best H; the best H / T; the H / T that is enough at nine of ten places
Given          what ``vehicle check`` proposes; the paper's 5 s
The judgement is by how much the error at a rule's horizon exceeds that at the best one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TypeAlias

import numpy as np

from benchmarks.horizon_map.places import Place, in_own_time
from ltv_mpc.control.horizon_selection import MIN_TIME_SCALES
from ltv_mpc.messages import Array

FOLDS = 8
RATIOS = tuple(np.geomspace(0.2, 4.0, 30).tolist())
PAPER_S = 5.0

Rule: TypeAlias = Callable[[Place], float]
"""Function that returns the horizon (s) for a place."""


def features(groups: Array) -> Array:
    """Return the features (K, 5) of groups (K, 4)."""
    strength, layer, change, delay = groups.T
    return np.column_stack([np.ones(len(groups)), np.log(strength), np.log(layer), change, delay])


def fitted(of: Sequence[Place]) -> Array:
    """Return the fitted coefficients a0 .. a4."""
    X = features(np.array([place.groups for place in of]))
    y = np.array([math.log(place.horizons_s[place.enough] / place.time_s) for place in of])
    found: Array = np.linalg.lstsq(X, y, rcond=None)[0]
    return found


def best_H_s(of: Sequence[Place]) -> float:
    """Return the horizon (s) with the smallest mean excess."""
    return float(min(of[0].horizons_s, key=lambda h: _excess(of, lambda _: float(h))))


def best_ratio(of: Sequence[Place]) -> float:
    """Return the ratio H / T with the smallest mean excess."""
    return float(min(RATIOS, key=lambda q: _excess(of, _so_many_times(q))))


def _excess(of: Sequence[Place], rule: Rule) -> float:
    return float(np.mean([place.excess(rule(place)) for place in of]))


def _so_many_times(ratio: float) -> Rule:
    return lambda place: ratio * place.time_s


def _always(horizon_s: float) -> Rule:
    return lambda _: horizon_s


def _by_groups(a: Array) -> Rule:
    return lambda place: float(place.time_s * math.exp(float(features(place.groups[None])[0] @ a)))


RULES: Mapping[str, Callable[[Sequence[Place]], Rule]] = {
    "H / T enough at nine of ten": lambda of: _so_many_times(float(np.quantile(in_own_time(of), 0.9))),
    "vehicle check": lambda _: _so_many_times(MIN_TIME_SCALES),
    "best H / T": lambda of: _so_many_times(best_ratio(of)),
    "best H": lambda of: _always(best_H_s(of)),
    "four groups": lambda of: _by_groups(fitted(of)),
    "5 s": lambda _: _always(PAPER_S),
}
"""Rules by name; each is fitted to given places."""


def judged(of: Sequence[Place]) -> dict[str, dict[str, float]]:
    """Return the excess of every rule at places that it was not fitted to: median, 90 % and worst; 0.1 is 10 %."""
    excess: dict[str, list[float]] = {name: [] for name in RULES}
    for fold in range(FOLDS):
        known = [place for i, place in enumerate(of) if i % FOLDS != fold]
        for name, fit in RULES.items():
            rule = fit(known)
            excess[name] += [place.excess(rule(place)) for place in of[fold::FOLDS]]
    return {
        name: {"median": float(np.median(x)), "p90": float(np.quantile(x, 0.9)), "worst": float(np.max(x))}
        for name, x in excess.items()
    }
