"""Controller with a fence or obstacles in closed loop: it keeps clear, arrives, and reports."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from ltv_mpc import Controller, ControllerConfig, Fence, Obstacle, Obstacles
from ltv_mpc.control.nominal_model import advance
from ltv_mpc.errors import ConfigError
from ltv_mpc.geofence.fence import Disc, Polygon
from ltv_mpc.geofence.obstacles import MAX_AGE_NS
from ltv_mpc.geofence.zones import clearances, pack_zones
from ltv_mpc.messages import Array, CurrentProfile, Estimate, Pair, Plan, PlanOrigin, SolveStatus
from ltv_mpc.references import Place, Point
from ltv_mpc.vehicle.parameters import Hull, Vehicle
from tests.ltv_mpc.control.problems import PAPER

CRAFT: Vehicle = msgspec.structs.replace(PAPER, hull=Hull(length_m=1.2, beam_m=0.6))
HULL_M = CRAFT.hull.radius_m if CRAFT.hull else 0.0
GOAL = (20.0, 0.0)


def disc(north_m: float, east_m: float, radius_m: float) -> Fence:
    return Fence(
        margin_m=0.5,
        keep_out_disc=(Disc(centre=Place(north_m=north_m, east_m=east_m), radius_m=radius_m, name="wreck"),),
    )


def box(north_m: float) -> Fence:
    corners = ((-4.0, -4.0), (north_m, -4.0), (north_m, 4.0), (-4.0, 4.0))
    return Fence(margin_m=0.5, keep_in=(Polygon(vertices=tuple(Place(north_m=n, east_m=e) for n, e in corners)),))


def controller(solver: str = "osqp") -> Controller:
    return Controller(CRAFT, Point(north_m=GOAL[0], east_m=GOAL[1]), ControllerConfig(solver=solver))


def drifting(water: Pair = (0.0, 0.0)) -> Estimate:
    profile = CurrentProfile(
        depth_m=np.array([0.0, 1.0]), north_mps=np.full(2, water[0]), east_mps=np.full(2, water[1])
    )
    return msgspec.structs.replace(
        Estimate.at_rest(), velocity_north_mps=water[0], velocity_east_mps=water[1], current=profile
    )


def fly(of: Controller, cycles: int, water: Pair = (0.0, 0.0)) -> tuple[Array, list[Plan]]:
    """Return positions (K, 2) and plans."""
    estimate, track, plans = drifting(water), [], []
    for _ in range(cycles):
        plans.append(of.plan(estimate))
        track.append((estimate.north_m, estimate.east_m))
        estimate = advance(CRAFT, estimate, plans[-1], duration_s=0.3)
    return np.array(track), plans


def hull_clearance(fence: Fence, track: Array) -> float:
    return float(clearances(pack_zones(fence), track).min()) - HULL_M


@pytest.mark.parametrize("water", [(0.0, 0.0), (-0.05, 0.15)], ids=["still", "current"])
def test_it_goes_round_a_disc_and_keeps_its_margin(water: Pair) -> None:
    fence, of = disc(10.0, 0.3, 3.0), controller()
    of.set_fence(fence)
    track, plans = fly(of, 260, water)
    assert hull_clearance(fence, track) > 0.49
    assert math.dist(track[-1], GOAL) < 0.5
    assert all(plan.origin is PlanOrigin.SOLVED and plan.solve.status is SolveStatus.SOLVED for plan in plans)
    reports = [plan.fence for plan in plans if plan.fence is not None]
    assert len(reports) == len(plans)
    assert any(report.active == ('keep_out_disc[0] "wreck"',) for report in reports)
    assert not any(report.inside or report.in_margin for report in reports[1:])


def test_without_a_fence_the_straight_line_goes_through_it() -> None:
    track, plans = fly(controller(), 150)
    assert hull_clearance(disc(10.0, 0.3, 3.0), track) < 0.0
    assert all(plan.fence is None for plan in plans)


def test_it_stays_in_a_box_and_waits_at_the_wall_for_a_point_beyond() -> None:
    fence, of = box(12.0), controller()
    of.set_fence(fence)
    track, plans = fly(of, 160)
    assert hull_clearance(fence, track) > 0.45
    assert track[-1][0] > 12.0 - HULL_M - 0.5 - 0.1
    assert np.hypot(*(track[-1] - track[-10])) < 0.02  # at rest
    assert all(plan.solve.status is SolveStatus.SOLVED for plan in plans)


def test_a_vehicle_inside_a_zone_leaves_it_by_the_nearest_exit() -> None:
    fence, of = disc(1.5, 0.3, 3.0), controller()
    of.set_fence(fence)
    track, plans = fly(of, 120)
    first = plans[0].fence
    assert first is not None
    assert first.inside == first.in_margin == ('keep_out_disc[0] "wreck"',)
    assert first.time_to_zone_ns == 0
    depth = clearances(pack_zones(fence), track)[:, 0]
    assert depth.min() > depth[0] - 0.2  # not across it
    assert depth[-1] > HULL_M + 0.45


def test_a_fence_needs_the_hull_and_a_rejected_one_changes_nothing() -> None:
    bare = Controller(msgspec.structs.replace(PAPER, hull=None), Point(north_m=1.0, east_m=0.0))
    with pytest.raises(ConfigError, match="hull"):
        bare.set_fence(disc(10.0, 0.0, 1.0))
    assert bare.fence_in_force(0).zones == ()
    of = controller()
    of.set_fence(disc(10.0, 0.0, 1.0))
    (zone,) = of.fence_in_force(0).zones
    assert (zone.keep_in, zone.radius_m, zone.margin_m) == (False, 1.0, 0.5)
    np.testing.assert_array_equal(zone.vertices_m, [[10.0, 0.0]])
    of.set_fence(None)
    assert of.plan(drifting()).fence is None


def test_it_avoids_a_moving_obstacle_and_says_when_it_is_dropped() -> None:
    of, estimate = controller(), drifting()
    crossing = Obstacle(
        id=7, t_ns=0, north_m=10.0, east_m=-8.0, velocity_north_mps=0.0, velocity_east_mps=0.35, radius_m=1.0
    )
    of.add_obstacles(Obstacles(t_ns=0, obstacles=(crossing,)))
    least, dropped = math.inf, []
    for _ in range(MAX_AGE_NS // 300_000_000 + 3):
        plan = of.plan(estimate)
        east_m = crossing.east_m + crossing.velocity_east_mps * estimate.t_ns * 1e-9
        least = min(least, math.hypot(estimate.north_m - 10.0, estimate.east_m - east_m) - 1.0 - HULL_M)
        dropped += plan.fence.dropped if plan.fence is not None else ()
        estimate = advance(CRAFT, estimate, plan, duration_s=0.3)
    assert least > 0.3
    assert dropped == [7]
