"""Short form of ``python -m benchmarks.strangers``: two foreign hulls under each condition, and the figures."""

from __future__ import annotations

import math
from itertools import cycle

import numpy as np
import pytest

from benchmarks.strangers.flight import Conditions, Flight
from benchmarks.strangers.tasks import CONDITIONS, SPEEDS_MPS, TASKS, Figures, Task, figures, fly_task

MEAN_M, MAX_M, ARRIVAL_S, FORCE = 0.25, 0.6, 40.0, 0.3
"""Limits at a point 5 m away, in 100 s under every condition; the force is mean |F| over the largest thrust."""


def short_of(found: Figures) -> list[str]:
    """Return the limits that a flight does not keep."""
    limits = {"mean_m": MEAN_M, "max_m": MAX_M, "arrival_s": ARRIVAL_S, "force": FORCE, "wrongly_nominal": 0.0}
    return [
        f"{name} = {getattr(found, name):.2f} > {limit}"
        for name, limit in limits.items()
        if getattr(found, name) > limit
    ]


@pytest.mark.parametrize(("hull", "condition"), list(zip(cycle(("ellipsoid", "light_boat")), CONDITIONS, strict=False)))
def test_a_stranger_comes_to_its_point_and_stays_there_under_each_condition(hull: str, condition: str) -> None:
    assert short_of(fly_task(hull, "hold", CONDITIONS[condition], 1)) == []


def test_a_stranger_follows_a_line() -> None:
    found = fly_task("catamaran", "line", CONDITIONS["nominal"], 1)
    assert found.mean_m < 0.5
    assert found.arrival_s < 1.6 * 20.0 / SPEEDS_MPS["catamaran"]


def along(points: np.ndarray, seconds: float, nominal: np.ndarray | None = None) -> Flight:
    """Return a flight whose estimated point moves evenly between points."""
    t_s = np.arange(1, round(100 * seconds) + 1) / 100
    at = np.linspace(0.0, seconds, len(points))
    point = np.stack([np.interp(t_s, at, points[:, i]) for i in range(2)], axis=1)
    track = np.zeros((len(t_s), 8))
    track[:, 6:] = 3.0
    content = np.ones(len(t_s), dtype=bool) if nominal is None else nominal
    return Flight(t_s, track, point, track[:, 6:], content, 0.0)


def test_the_error_along_a_path_counts_until_the_arrival_and_at_a_point_after_it() -> None:
    line = along(np.array([[0.0, 2.0], [20.0, 2.0], [20.0, 0.0], [20.0, 0.0]]), 90.0)
    found = figures(TASKS["line"], line, Conditions(), max_N=30.0)
    assert found.arrival_s == pytest.approx(30.0 + 30.0 * 0.75, abs=0.02)
    assert found.max_m == pytest.approx(2.0)
    assert found.force == pytest.approx(0.1)
    assert found.wrongly_nominal == pytest.approx((30.0 + 15.0) / found.arrival_s, abs=0.01)

    point = Task(((0.0, ((4.0, 0.0),)),), 100.0, 0.3)
    held = along(np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 0.0], [4.0, 0.0], [4.0, 0.0]]), 100.0)
    assert figures(point, held, Conditions(), 30.0)[:3] == pytest.approx((0.0, 0.0, 25.0 * 3.5 / 4.0), abs=0.02)
    lost = figures(point, along(np.array([[0.0, 0.0], [0.0, 0.0]]), 100.0), Conditions(), 30.0)
    assert lost == pytest.approx((4.0, 4.0, math.inf, 0.1, 1.0))


def test_a_square_is_done_when_its_corners_have_been_reached_not_at_its_first_corner() -> None:
    corners = np.array(TASKS["square"].targets[0][1])
    whole = figures(TASKS["square"], along(corners, 160.0), Conditions(), 30.0)
    assert whole.arrival_s == pytest.approx(160.0, abs=1.5)
    stays = figures(TASKS["square"], along(corners[[0, 0]], 160.0), Conditions(), 30.0)
    assert stays.arrival_s == math.inf
