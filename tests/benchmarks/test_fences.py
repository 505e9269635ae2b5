"""The study of fences: what its scenes promise, and how it judges a flight."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.fences.flight import Job, drawn, fly, keeps
from benchmarks.fences.scenes import Scene, vehicle_of
from ltv_mpc.geofence.fence import Disc, Fence
from ltv_mpc.references import Place


def scene_with_disc() -> Scene:
    """Return a scene with one disc of 5 m at 20 m north, whose margin is 1 m."""
    vehicle, _ = vehicle_of("paper")
    disc = Disc(centre=Place(north_m=20.0, east_m=0.0), radius_m=5.0)
    return Scene("paper", vehicle, Fence(margin_m=1.0, keep_out_disc=(disc,)), None, (40.0, 0.0), (0.0, 0.0), 0.0, 1e3)


def test_a_track_through_a_zone_is_a_violation_and_one_beside_it_is_not() -> None:
    """Clearance and depth in the margin of two tracks."""
    scene = scene_with_disc()
    assert scene.vehicle.hull is not None
    hull = scene.vehicle.hull.radius_m
    north, t = np.linspace(0.0, 40.0, 401), np.linspace(0.0, 100.0, 401)
    through = np.column_stack([north, np.full(401, 1e-3)])
    assert keeps(scene, through, t) == (pytest.approx(-5.0 - hull, abs=0.01), pytest.approx(6.0 + hull, abs=0.01))
    beside = np.column_stack([north, np.full(401, 5.5 + hull)])
    assert keeps(scene, beside, t) == (pytest.approx(0.5), pytest.approx(0.5))


def test_a_vehicle_with_a_wrong_file_keeps_its_margin() -> None:
    """Heavier, with less drag and thrust than its file; without the growth it enters its margin by 0.23 m."""
    wrong = fly(Job(39, False, model="heavy"))
    assert wrong.arrived
    assert wrong.entered_m < 0.1
    assert {drawn(seed).mass for seed in range(9)} == {0.7, 1.3}


def test_an_obstacle_that_is_reported_every_10_s_is_kept_clear_of() -> None:
    """AIS has such rates, between which the uncertainty grows."""
    rare = fly(Job(0, True, 10.0))
    assert rare.clearance_m > 0.0
    assert rare.arrived
