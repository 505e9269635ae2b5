"""Controller with a fence or obstacles in closed loop: it keeps clear, arrives, and reports."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from ltv_mpc import Controller, ControllerConfig, Fence, Obstacle, Obstacles
from ltv_mpc.control.config import MotionLimits
from ltv_mpc.control.fencing import Fencing
from ltv_mpc.control.nominal_model import advance
from ltv_mpc.control.ocp.limits import ROWS
from ltv_mpc.control.prediction import Prediction
from ltv_mpc.control.scaling import characteristic_scales
from ltv_mpc.control.solvers import Solver, make
from ltv_mpc.control.solvers.recorder import RecordingSolver
from ltv_mpc.errors import ConfigError
from ltv_mpc.geofence.fence import Disc
from ltv_mpc.geofence.obstacles import MAX_AGE_NS
from ltv_mpc.geofence.zones import clearances, pack_zones
from ltv_mpc.messages import Array, Health, Pair, Plan, PlanOrigin, SolveStatus
from ltv_mpc.references import Line, Place, Point, Reference, Waypoints
from ltv_mpc.vehicle.parameters import Hull, Vehicle
from tests.ltv_mpc.control.flights import drifting, fly, track
from tests.ltv_mpc.control.problems import PAPER
from tests.ltv_mpc.geofence.shapes import polygon

CRAFT: Vehicle = msgspec.structs.replace(PAPER, hull=Hull(length_m=1.2, beam_m=0.6))
HULL_M = CRAFT.hull.radius_m if CRAFT.hull else 0.0
GOAL = (20.0, 0.0)


def disc(north_m: float, east_m: float, radius_m: float) -> Fence:
    return Fence(
        margin_m=0.5,
        keep_out_disc=(Disc(centre=Place(north_m=north_m, east_m=east_m), radius_m=radius_m, name="wreck"),),
    )


def walls(*rings: list[tuple[float, float]]) -> Fence:
    return Fence(margin_m=0.2, keep_out=tuple(polygon(np.array(ring)) for ring in rings))


def controller(reference: Reference | None = None, **settings) -> Controller:
    return Controller(CRAFT, reference or Point(north_m=GOAL[0], east_m=GOAL[1]), ControllerConfig(**settings))


def fenced(fence: Fence, reference: Reference | None = None, **settings) -> tuple[Fence, Controller]:
    """Return a fence, and a controller that has it."""
    of = controller(reference, **settings)
    of.set_fence(fence)
    return fence, of


def line(north_m: float) -> Line:
    return Line(start=Place(north_m=0.0, east_m=0.0), end=Place(north_m=north_m, east_m=0.0), speed_mps=0.3)


def flown(of: Controller, cycles: int, water: Pair = (0.0, 0.0)) -> tuple[Array, list[Plan]]:
    """Return positions (K, 2) and plans."""
    way, plans = fly(of, drifting(*water), cycles)
    return track(way), plans


def hull_clearance(fence: Fence, way: Array) -> float:
    return float(clearances(pack_zones(fence), way).min()) - HULL_M


def test_it_goes_round_a_disc_and_keeps_its_margin() -> None:
    fence, of = fenced(disc(10.0, 0.3, 3.0))
    way, plans = flown(of, 230, (-0.05, 0.15))
    assert hull_clearance(fence, way) > 0.49
    assert math.dist(way[-1], GOAL) < 0.5
    assert all(plan.origin is PlanOrigin.SOLVED and plan.solve.status is SolveStatus.SOLVED for plan in plans)
    reports = [plan.fence for plan in plans if plan.fence is not None]
    assert len(reports) == len(plans)
    assert any(report.active == ('keep_out_disc[0] "wreck"',) for report in reports)
    assert not any(report.inside or report.in_margin for report in reports[1:])


def test_a_vehicle_inside_a_zone_leaves_it_by_the_nearest_exit() -> None:
    fence, of = fenced(disc(1.5, 0.3, 3.0))
    way, plans = flown(of, 90)
    first = plans[0].fence
    assert first is not None
    assert first.inside == first.in_margin == ('keep_out_disc[0] "wreck"',)
    assert first.time_to_zone_ns == 0
    depth = clearances(pack_zones(fence), way)[:, 0]
    assert depth.min() > depth[0] - 0.2  # not across it
    assert depth[-1] > HULL_M + 0.45


FAR_DISC = disc(1000.0, 0.0, 3.0)


def test_the_first_cycle_with_a_fence_sets_up_the_solver_that_all_later_ones_use() -> None:
    solvers = list[RecordingSolver]()

    def make_recording(vehicle: Vehicle, config: ControllerConfig) -> Solver:
        solvers.append(RecordingSolver(make(vehicle, config)))
        return solvers[-1]

    of = Controller(CRAFT, Point(north_m=GOAL[0], east_m=GOAL[1]), make_solver=make_recording)
    for fence, count, rows in ((None, 1, 0), (FAR_DISC, 2, 3), (disc(5.0, 0.0, 2.0), 2, 3), (None, 3, 0)):
        of.set_fence(fence)
        of.plan(drifting())
        assert (len(solvers), solvers[-1].problem.sizes[3] - ROWS) == (count, rows)


def test_between_walls_that_are_too_near_for_their_margins_the_hull_stays_free() -> None:
    """There is 0.3 m to either side of the hull: with penalties that cancel, the current led it 0.2 m into one."""
    corners = ((-5.0, 0.0), (15.0, 0.0), (15.0, 3.0), (-5.0, 3.0))
    sides = ([(n, side * (e + HULL_M + 0.3)) for n, e in corners] for side in (-1.0, 1.0))
    fence, of = fenced(msgspec.structs.replace(walls(*sides), margin_m=1.0), Point(north_m=8.0, east_m=0.0))
    way, plans = flown(of, 120, (0.0, 0.08))
    assert hull_clearance(fence, way) > 0.03
    assert all(plan.solve.status is SolveStatus.SOLVED for plan in plans)


def test_a_report_says_what_the_hull_is_in_and_how_many_rows_a_plan_lacks() -> None:
    fencing, estimate = Fencing(CRAFT, np.arange(3) * 300_000_000), drifting()
    fencing.set_fence(disc(10.0, 0.0, 3.0))
    start = Prediction(CRAFT).state_at(estimate, estimate.t_ns)
    fencing.update(start, estimate, 0.0)
    for gap_m, in_margin, inside, exceeded in ((0.6, 0, 0, 0), (0.4, 1, 0, 1), (-0.1, 1, 1, 1)):
        X = np.zeros((3, 6))
        X[:, 0] = 7.0 - HULL_M - gap_m
        report = fencing.report(X, 0.0, drifts=False)
        assert report is not None
        assert report.clearance_m == pytest.approx(gap_m)
        assert (len(report.in_margin), len(report.inside), min(report.exceeded, 1)) == (in_margin, inside, exceeded)


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


def test_an_obstacle_from_the_future_is_dropped_and_a_current_one_avoided() -> None:
    """A receiver that stamps UTC, where vehicle time begins at 0: the vehicle collided, and nothing said why."""
    of, estimate = controller(), drifting()
    head_on = Obstacle(
        id=7, t_ns=0, north_m=15.0, east_m=0.0, velocity_north_mps=-0.1, velocity_east_mps=0.0, radius_m=1.0
    )
    utc = Obstacles(t_ns=0, obstacles=(msgspec.structs.replace(head_on, t_ns=1_700_000_000_000_000_000),))
    of.add_obstacles(utc)
    plan, least_m = of.plan(estimate), math.inf
    assert plan.fence is not None
    assert (plan.fence.dropped, plan.fence.clearance_m) == ((7,), None)
    assert of.plan(estimate).fence is None
    of.add_obstacles(Obstacles(t_ns=0, obstacles=(head_on,)))
    for _ in range(150):
        of.add_obstacles(utc)
        plan = of.plan(estimate)
        assert plan.fence is not None
        assert (plan.fence.dropped, plan.fence.nearest) == ((7,), "obstacle 7")
        north_m = head_on.north_m + head_on.velocity_north_mps * estimate.t_ns * 1e-9
        least_m = min(least_m, math.hypot(estimate.north_m - north_m, estimate.east_m) - 1.0 - HULL_M)
        estimate = advance(CRAFT, estimate, plan, duration_s=0.3)
    assert least_m > 0.3


def at_anchor(t_ns: int, number: int = 7) -> Obstacles:
    drifts = Obstacle(
        id=number, t_ns=t_ns, north_m=12.0, east_m=0.0, velocity_north_mps=0.0, velocity_east_mps=0.01, radius_m=1.0
    )
    return Obstacles(t_ns=t_ns, obstacles=(drifts,))


def test_a_path_leads_round_an_obstacle_at_anchor_with_a_reported_speed() -> None:
    """AIS has steps of 0.1 kn, which is more than a tenth of the vehicle's top speed."""
    of, estimate, least_m = controller(line(26.0)), drifting(), math.inf
    for cycle in range(360):
        if cycle % 7 == 0:
            course, speed_mps = 2.4 * (cycle // 7), 0.1 * 0.514444
            ship = msgspec.structs.replace(
                at_anchor(estimate.t_ns).obstacles[0],
                north_m=13.0,
                velocity_north_mps=speed_mps * math.cos(course),
                velocity_east_mps=speed_mps * math.sin(course),
            )
            of.add_obstacles(Obstacles(t_ns=estimate.t_ns, obstacles=(ship,)))
        plan = of.plan(estimate)
        least_m = min(least_m, math.hypot(estimate.north_m - 13.0, estimate.east_m) - 1.0 - HULL_M)
        if plan.progress == 1.0:
            break
        estimate = advance(CRAFT, estimate, plan, duration_s=0.3)
    assert plan.progress == 1.0
    assert least_m > HULL_M


def test_a_path_is_whole_again_when_an_obstacle_leaves() -> None:
    of, skipped_m = controller(line(24.0)), []
    for cycle in range(MAX_AGE_NS // 300_000_000 + 3):
        if cycle == 1:
            of.add_obstacles(at_anchor(300_000_000))
        plan = of.plan(msgspec.structs.replace(drifting(), t_ns=cycle * 300_000_000))
        skipped_m.append(plan.fence.skipped_m if plan.fence is not None else 0.0)
    assert skipped_m[0] == skipped_m[-1] == 0.0
    assert min(skipped_m[1:-3]) > 5.0
    assert len(set(skipped_m)) < 20  # a detour is not computed in every cycle


def test_a_path_through_a_zone_is_followed_on_the_other_side_also_in_a_corridor() -> None:
    fence, of = fenced(disc(9.0, 0.5, 2.0), line(18.0), limits=MotionLimits(max_cross_track_m=0.3))
    way, plans = flown(of, 270)
    assert hull_clearance(fence, way) > 0.45
    assert plans[-1].progress == pytest.approx(1.0)
    assert math.dist(way[-1], (18.0, 0.0)) < 0.3
    progress = np.array([plan.progress for plan in plans])
    assert np.diff(progress[progress < 1.0])[20:].min() > 0.0  # it does not wait in front of the zone
    (skipped_m,) = {plan.fence.skipped_m for plan in plans if plan.fence is not None}
    assert skipped_m == pytest.approx(2.0 * math.sqrt((2.0 + 0.5 + HULL_M) ** 2 - 0.5**2), abs=0.15)
    north = way[np.abs(way[:, 1]) < 0.2, 0]
    assert (north < 9.0).any()
    assert np.count_nonzero(north > 12.5) > 30  # on the path again, well before its end


def test_a_point_in_a_zone_becomes_the_nearest_allowed_point() -> None:
    _, of = fenced(disc(GOAL[0], GOAL[1] + 0.5, 3.0))
    way, plans = flown(of, 180)
    wanted = (20.0, 0.5 - (3.0 + 0.5 + HULL_M))
    assert plans[-1].reference_m == pytest.approx(wanted, abs=1e-4)
    assert math.dist(way[-1], wanted) < 0.1
    assert plans[-1].fence is not None
    assert plans[-1].fence.skipped_m == pytest.approx(math.dist(wanted, GOAL), abs=1e-4)


def test_a_fence_set_or_removed_under_way_keeps_the_progress() -> None:
    of, estimate, progress = controller(line(24.0)), drifting(), []
    for cycle in range(60):
        if cycle in (30, 45):
            of.set_fence(disc(12.0, 0.0, 3.0) if cycle == 30 else None)
        plan = of.plan(estimate)
        progress.append(plan.progress or 0.0)
        skipped_m = 0.0 if plan.fence is None else plan.fence.skipped_m
        assert (skipped_m > 7.0) == (30 <= cycle < 45)
        estimate = advance(CRAFT, estimate, plan, duration_s=0.3)
    assert progress[44] > 0.05
    assert np.diff(progress).min() >= -1e-9
    assert np.diff(progress).max() < 0.01


def test_before_a_target_without_a_way_to_it_the_vehicle_rests() -> None:
    """In the last 18 s it stays where it is, with no more thrust than the current needs and a tenth."""
    closed = [
        [(8.0, -4.0), (8.0, 4.0), (9.0, 4.0), (9.0, -4.0)],
        [(15.0, -4.0), (15.0, 4.0), (16.0, 4.0), (16.0, -4.0)],
        [(8.0, -4.0), (16.0, -4.0), (16.0, -5.0), (8.0, -5.0)],
        [(8.0, 4.0), (16.0, 4.0), (16.0, 5.0), (8.0, 5.0)],
    ]
    fence, of, water = walls(*closed), controller(Point(north_m=12.0, east_m=0.0)), (-0.1, 0.05)
    of.set_fence(fence)
    way, plans = flown(of, 260, water)
    assert hull_clearance(fence, way) > 0.15
    assert all(plan.fence is not None and plan.fence.no_way for plan in plans)
    assert np.ptp(way[-60:], axis=0).max() < 0.02
    surge, speed_mps = CRAFT.surge, math.hypot(*water)
    drag_N = (surge.linear_damping_kgps + surge.quadratic_damping_kgpm * speed_mps) * speed_mps
    thrust_N = np.array([plan.thrust_N[0, :2] for plan in plans[-60:]])
    assert np.abs(thrust_N).sum(axis=1).max() < 1.1 * drag_N + 0.15


def test_a_corridor_keeps_the_vehicle_nearer_to_its_path_at_a_corner() -> None:
    """After it has reached its path; without a corridor it is 0.09 m off."""
    corner = Place(north_m=0, east_m=0), Place(north_m=12, east_m=0), Place(north_m=12, east_m=12)
    limits = MotionLimits(max_cross_track_m=0.05)
    _, plans = flown(controller(Waypoints(waypoints=corner, speed_mps=0.3), limits=limits), 200, (0.0, -0.1))
    assert max(abs(plan.cross_track_m or 0.0) for plan in plans[33:]) < 0.051


def test_a_plan_that_no_other_one_follows_stops_before_a_wall() -> None:
    slow_turner = msgspec.structs.replace(Vehicle.load("low-yaw"), hull=CRAFT.hull)
    wall, of = (
        walls([(12, -3), (13, -3), (13, 8), (12, 8)]),
        Controller(slow_turner, Point(north_m=20.0, east_m=0.0)),
    )
    of.set_fence(wall)
    estimate, least_m = drifting(), math.inf
    for _ in range(110):
        plan = of.plan(estimate)
        times = estimate.t_ns + np.arange(500_000_000, 14_000_000_000, 500_000_000)
        alone = np.array([of.predict(estimate, int(t))[:2] for t in times])  # with the stop of the actuators
        least_m = min(least_m, hull_clearance(wall, alone))
        estimate = advance(slow_turner, estimate, plan, duration_s=0.3)
    assert least_m > -0.05  # a tenth of the margin: it may enter between two of the times that are looked at


def test_margins_grow_by_what_the_model_s_error_carries_the_vehicle_until_it_stops() -> None:
    fencing, scales = Fencing(CRAFT, np.arange(3) * 300_000_000), characteristic_scales(CRAFT)
    fencing.set_fence(disc(100.0, 0.0, 3.0))
    needed_m = []
    for share in (0.0, 0.5, 1.0):
        start = Prediction(CRAFT).state_at(drifting(), 0)
        start.lateral[2] = share * scales.speed_mps
        fencing.update(start, drifting(), 0.0, 0.02)
        needed_m.append(float(fencing.scene.need[0]) - HULL_M - 0.5)
    assert needed_m == pytest.approx([0.0, 0.25 * 0.01 * scales.time_s**2, 0.01 * scales.time_s**2])


def test_the_vehicle_stops_between_zones_whose_margins_meet_while_estimates_are_late() -> None:
    side = HULL_M + 0.55  # half the distance between two walls
    sides = ([(-5.0, e), (30.0, e), (30.0, e + 3.0), (-5.0, e + 3.0)] for e in (side, -side - 3.0))
    _, of = fenced(walls(*sides), line(24.0))
    estimate = msgspec.structs.replace(drifting(), covariance=np.diag([0.18**2] * 2 + [1e-4] * 4))
    assert of.plan(estimate).origin is PlanOrigin.SOLVED
    late = of.plan(estimate, t_ns=estimate.t_ns + 3_000_000_000)
    assert late.health is Health.DEGRADED
    assert late.origin is PlanOrigin.STOP
    assert "margins meet" in late.why
    fresh = msgspec.structs.replace(estimate, t_ns=estimate.t_ns + 3_300_000_000)
    assert of.plan(fresh).origin is PlanOrigin.SOLVED


def test_a_plan_without_control_says_when_the_vehicle_drifts_into_a_zone() -> None:
    _, of = fenced(disc(0.0, 30.0, 5.0), Point(north_m=0.0, east_m=0.0))
    estimate = drifting(0.0, 0.2)
    assert of.plan(estimate).fence is not None
    late = of.plan(estimate, t_ns=estimate.t_ns + 30_000_000_000)
    assert late.origin is not PlanOrigin.SOLVED
    assert late.fence is not None
    gap_m = 30.0 - 5.0 - HULL_M - late.states[0, 1]
    assert late.fence.time_to_zone_ns == pytest.approx(gap_m / 0.2 * 1e9, rel=0.02)
    with pytest.MonkeyPatch.context() as patch:  # a cycle that raises
        patch.setattr("ltv_mpc.control.prediction.Prediction.state_at", None)
        assert of.plan(estimate).fence.time_to_zone_ns == pytest.approx((25.0 - HULL_M) / 0.2 * 1e9, rel=0.02)
    away = of.plan(drifting(0.0, -0.2), t_ns=estimate.t_ns + 30_000_000_000)
    assert away.fence is not None
    assert away.fence.time_to_zone_ns is None
