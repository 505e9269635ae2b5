"""The study of fences: what its scenes promise, and how it judges a flight."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from benchmarks.fences import full_loop
from benchmarks.fences.__main__ import table
from benchmarks.fences.flight import Job, drawn, fly, judged, keeps, sides, summed_cost
from benchmarks.fences.rivals import HardRows, waypoints
from benchmarks.fences.scenes import GAP_FACTOR, Scene, scene_of, vehicle_of
from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.control.ocp import assembly, limits
from ltv_mpc.control.ocp.problem import Problem
from ltv_mpc.control.resolution import settled
from ltv_mpc.control.scaling import characteristic_scales
from ltv_mpc.control.solvers.qpsolvers_backend import QpsolversBackend
from ltv_mpc.geofence.fence import Disc, Fence
from ltv_mpc.geofence.zones import clearance, nearest, pack_zones
from ltv_mpc.references import Place


def scene_with_disc() -> Scene:
    """Return a scene with one disc of 5 m at 20 m north, whose margin is 1 m."""
    vehicle, _ = vehicle_of("paper")
    disc = Disc(centre=Place(north_m=20.0, east_m=0.0), radius_m=5.0)
    return Scene("paper", vehicle, Fence(margin_m=1.0, keep_out_disc=(disc,)), None, (40.0, 0.0), (0.0, 0.0), 0.0, 1e3)


def test_gaps_leave_room_for_two_margins_and_the_drift_of_a_turn() -> None:
    """Zones of 30 random scenes, by the circles round them, and both ends of the lane."""
    for seed in range(30):
        scene = scene_of(seed, moving=False)
        vehicle, can = vehicle_of(scene.name)
        assert scene.fence is not None
        assert vehicle.hull is not None
        L = characteristic_scales(vehicle).length_m
        gap = GAP_FACTOR * (
            2.0 * vehicle.hull.radius_m + 0.3 * L + math.hypot(*scene.water) * (can.turn_90deg_s or math.inf)
        )
        zones = pack_zones(scene.fence)
        for z, (first, end) in enumerate(pairwise(zones.first)):
            # The two nearest points of convex zones are a vertex and a point of the other boundary.
            others = [
                clearance(zones, other, n, e)
                for other in range(len(zones.radius))
                if other != z
                for n, e in zones.vertices[first:end]
            ]
            assert min(others, default=math.inf) - zones.radius[z] > gap - 1e-6, seed
            assert all(clearance(zones, z, *end) > gap - 1e-6 for end in ((0.0, 0.0), scene.goal)), seed


def test_a_track_through_a_zone_is_a_violation_and_one_beside_it_is_not() -> None:
    """Clearance, depth in the margin, side and cost of two tracks."""
    scene = scene_with_disc()
    assert scene.vehicle.hull is not None
    hull = scene.vehicle.hull.radius_m
    north, t = np.linspace(0.0, 40.0, 401), np.linspace(0.0, 100.0, 401)
    through = np.column_stack([north, np.full(401, 1e-3)])
    assert keeps(scene, through, t) == (pytest.approx(-5.0 - hull, abs=0.01), pytest.approx(6.0 + hull, abs=0.01))
    beside = np.column_stack([north, np.full(401, 5.5 + hull)])
    assert keeps(scene, beside, t) == (pytest.approx(0.5), pytest.approx(0.5))
    assert sides(scene, beside) == [-s for s in sides(scene, beside * [1.0, -1.0])]
    still = np.zeros((401, 2))
    lack = np.maximum(6.0 + hull - np.hypot(beside[:, 0] - 20.0, beside[:, 1]), 0.0)  # m; 1 m costs 2 x 5000
    distances = np.hypot(*(beside - scene.goal).T)
    assert summed_cost(scene, beside, still) == pytest.approx((distances[1:] ** 2).sum() + 1e4 * lack.sum())


def test_bent_waypoints_keep_hull_and_margin() -> None:
    """The way of the rivals round one disc."""
    scene = scene_with_disc()
    assert scene.vehicle.hull is not None
    corners = np.array([(0.0, 0.0), *waypoints(scene)])
    share = np.linspace(0.0, 1.0, 200)[:, None, None]
    line = (corners[:-1] + share * np.diff(corners, axis=0)).reshape(-1, 2)
    assert len(corners) > 2
    assert np.hypot(line[:, 0] - 20.0, line[:, 1]).min() > 5.0 + 1.0 + scene.vehicle.hull.radius_m - 0.05


def test_the_controller_arrives_without_a_violation_and_the_table_counts_it() -> None:
    """One scene, and its row of the table."""
    flown = fly(Job(2, "fence", False))
    assert flown.arrived
    assert flown.clearance_m > 0.0
    row = table({"zones fence 2": {**flown._asdict(), "clearance_m": -0.25}}).splitlines()[-1]
    assert row.startswith("| zones | fence | 1 | 1 | -0.250 |")


def test_a_vehicle_with_a_wrong_file_keeps_its_margin() -> None:
    """Heavier, with less drag and thrust than its file; without the growth it enters its margin by 0.23 m."""
    wrong, right = (fly(Job(39, "fence", False, model=model)) for model in ("heavy", "right"))
    assert wrong.arrived
    assert wrong.entered_m < 0.1
    assert wrong.track_m != right.track_m
    assert {drawn(seed).mass for seed in range(9)} == {0.7, 1.3}


@pytest.mark.parametrize("seed", range(4))
def test_an_obstacle_that_is_reported_every_2_or_10_s_is_kept_clear_of(seed) -> None:
    """AIS has such rates; the ways differ, because the uncertainty has grown less where reports are frequent."""
    often, rare = (fly(Job(seed, "fence", True, report_s)) for report_s in (2.0, 10.0))
    assert often.clearance_m > 0.0
    assert rare.clearance_m > 0.0
    assert often.arrived
    assert rare.arrived
    assert often.track_m != rare.track_m


def test_the_rival_has_hard_rows_for_the_fence_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[Problem] = []
    monkeypatch.setattr(QpsolversBackend, "build", lambda _, problem: given.append(problem))
    problem = assembly.empty(3, 2)
    problem.penalty[:] = 7.0
    HardRows(settled(ControllerConfig(), vehicle_of("paper")[0])).build(problem)
    hard = np.isinf(given[0].penalty)
    assert hard[:, limits.ROWS :].all()
    assert not hard[:, : limits.ROWS].any()
    assert (problem.penalty == 7.0).all()  # that of the controller stays


def test_a_flight_with_sensors_is_judged_by_the_true_positions() -> None:
    """A straight track over the first zone."""
    scene = scene_of(1, moving=False)
    assert scene.fence is not None
    circle = pack_zones(scene.fence).circle[0]
    seen = full_loop.Seen()
    seen.track = [(float(north), float(circle[1])) for north in np.linspace(0.0, 2.0 * circle[0], 200)]
    seen.t_s, seen.unsolved_s, seen.cycles = list(np.arange(200) * 0.01), [0.3], 7
    flown = judged(scene, seen, True)
    assert flown.clearance_m < 0.0
    assert (flown.arrived, flown.unsolved_s, flown.cycles) == (True, [0.3], 7)
    assert flown.duration_s == pytest.approx(1.99)


def test_the_clearance_in_symbols_is_that_of_the_zones() -> None:
    """Convex polygons and discs of ten scenes, at points inside and outside."""
    ca = pytest.importorskip("casadi")
    from benchmarks.fences import nonlinear

    rng = np.random.default_rng(0)
    for seed in range(10):
        fence = scene_of(seed, moving=False).fence
        assert fence is not None
        zones = pack_zones(fence)
        for z in range(len(zones.radius)):
            point = ca.SX.sym("point", 2)
            symbolic = ca.Function("clearance", [point], [nonlinear.clearance(zones, z, point)])
            for at in zones.circle[z, :2] + zones.circle[z, 2] * rng.uniform(-2.0, 2.0, (40, 2)):
                assert float(symbolic(at)) == pytest.approx(nearest(zones, z, *at)[0], abs=1e-6)
