"""Analysis of the horizon map: it recovers a known law, and reads a campaign's folder."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from benchmarks.horizon_map import rules
from benchmarks.horizon_map.places import Place
from ltv_mpc.control.horizon_selection import MIN_TIME_SCALES

PAGE = Path(__file__).parents[2] / "docs" / "horizon.md"
HORIZONS = np.geomspace(1.0, 32.0, 21)
LAW = np.array([0.2, -0.3, 0.4, -0.8, 0.5])


def made_up(count: int) -> list[Place]:
    """Return places whose errors are smallest at the law's horizon, jump below it and grow above it."""
    rng = np.random.default_rng(3)
    made = []
    for _ in range(count):
        groups = np.array([*np.exp(rng.uniform(-1, 1, 2)), *rng.uniform(0, 0.5, 2)])
        time_s = float(rng.uniform(4, 8))
        enough = time_s * math.exp(float(rules.features(groups[None])[0] @ LAW))
        errors = np.where(enough <= HORIZONS, np.sqrt(HORIZONS / enough), 1.3 * (enough / HORIZONS) ** 2)
        made.append(Place(time_s, groups, HORIZONS, errors))
    return made


def test_the_true_rule_is_found_and_beats_constants_outside_the_fitted_range() -> None:
    of = made_up(200)
    found = rules.fitted(of)
    # what is enough is the next horizon of the design above the law's: half a step of it, in the mean
    np.testing.assert_allclose(found[1:], LAW[1:], atol=0.1)
    assert found[0] - LAW[0] == pytest.approx(0.5 * math.log(HORIZONS[1] / HORIZONS[0]), abs=0.1)
    judged = rules.judged(of)
    assert judged["four groups"]["p90"] < 0.5 * judged["best H / T"]["p90"]
    assert judged["best H / T"]["p90"] < judged["5 s"]["p90"]


def test_the_rule_that_vehicle_check_proposes_loses_little_at_nine_of_ten_places() -> None:
    """At places that no rule was fitted to, state known: at most 5 points more than the best of all rules."""
    kept = json.loads(PAGE.with_suffix(".json").read_text(encoding="utf-8"))["state known"]
    assert kept["proposed_over_T"] == MIN_TIME_SCALES, "make map"
    excess = {name: figures["p90"] for name, figures in kept["excess_at_places_not_fitted_to"].items()}
    assert excess["vehicle check"] <= min(excess.values()) + 0.05
