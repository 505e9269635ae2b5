"""Short form of ``python -m benchmarks.strangers``: two foreign hulls under its conditions."""

from __future__ import annotations

from itertools import cycle

import pytest

from benchmarks.strangers.tasks import CONDITIONS, SPEEDS_MPS, Figures, fly_task

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


KINDS = [name for name in CONDITIONS if name not in ("nominal", "no reports", "offset 0.15 m")]
"""Without those of ``test_hold.py`` and ``test_wrong_rates.py``."""


@pytest.mark.parametrize(("hull", "condition"), list(zip(cycle(("ellipsoid", "light_boat")), KINDS, strict=False)))
def test_a_stranger_comes_to_its_point_and_stays_there_under_each_condition(hull: str, condition: str) -> None:
    assert short_of(fly_task(hull, "hold", CONDITIONS[condition], 1)) == []


def test_a_stranger_follows_a_line() -> None:
    found = fly_task("catamaran", "line", CONDITIONS["nominal"], 1)
    assert found.mean_m < 0.5
    assert found.arrival_s < 1.6 * 20.0 / SPEEDS_MPS["catamaran"]
