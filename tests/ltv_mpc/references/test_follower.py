"""Follower: progress and waiting of the target, and the controller in closed loop."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from ltv_mpc import Controller, CurrentProfile, Estimate, Vehicle, advance
from ltv_mpc.references import Hold, Line, Place, Point, Reference, Timed
from ltv_mpc.references.follower import MAX_STEP_S, Follower
from ltv_mpc.references.limits import path_limits

PAPER = Vehicle.load("paper")
LINE = Line(speed_mps=0.3, start=Place(north_m=0.0, east_m=0.0), end=Place(north_m=12.0, east_m=0.0))
S = 1_000_000_000
STILL = (0.0, 0.0)


def knots(t_s: float) -> np.ndarray:
    return round(t_s * S) + np.arange(18) * 300_000_000


def has_started(reference: Reference, **start: float) -> Follower:
    follower = Follower(reference, PAPER)
    assert follower.begin(Estimate.at_rest(depth_m=0.0, **start))
    return follower


def go(follower: Follower, t_s: float, north_m: float, east_m: float, current=STILL) -> tuple[float, float]:
    follower.advance(knots(t_s), np.array([north_m, east_m]), current, np.empty((18, 2)))
    assert follower.target_m is not None
    return follower.target_m


def test_the_target_keeps_its_schedule_while_the_vehicle_is_near():
    follower, t_s = has_started(LINE), 0.0
    while t_s < 20.0:
        t_s += 0.3
        target = go(follower, t_s, *(follower.target_m or STILL))
    table = LINE.schedule(PAPER).table
    assert target[0] == pytest.approx(np.interp(t_s, table[0], table[2]))
    assert follower.progress.share == pytest.approx(target[0] / 12.0)
    assert follower.progress.remaining_m == pytest.approx(12.0 - target[0])


class CountedLine(Line, frozen=True, kw_only=True):
    """Line that counts its schedules in ``counts``."""

    counts: list[int]

    def schedule(self, vehicle, anchor=None):
        self.counts.append(1)
        return super().schedule(vehicle, anchor)


def test_another_restriction_does_not_compute_the_path_again():
    line = CountedLine(counts=[], start=LINE.start, end=LINE.end, speed_mps=LINE.speed_mps)
    follower, seen = has_started(line), []
    for _ in range(3):
        follower.restrict(lambda schedule: (seen.append(schedule), (schedule, 0.0))[1])
    assert line.counts == [1]
    assert all(schedule is seen[0] for schedule in seen)


def test_the_target_waits_for_a_vehicle_that_falls_behind_and_never_goes_back():
    follower, t_s, way = has_started(LINE), 0.0, []
    for behind in (0.0, 0.3, 0.6, 0.7, 3.0, 3.0, 3.0, 0.0, 0.0):
        for _ in range(10):
            t_s += 0.3
            north = follower.target_m[0] if follower.target_m else 0.0
            way.append(go(follower, t_s, north - behind, 0.0)[0])
    steps = np.diff(way)
    assert (steps >= 0.0).all()
    assert steps[52:70] == pytest.approx(0.0)  # three metres behind: it stands
    assert steps[-1] == pytest.approx(0.09)  # and goes on at 0.3 m/s
    assert 0.01 < steps[38] < 0.08  # 0.7 m behind: slowly


def test_a_current_from_ahead_slows_the_target_down_before_the_vehicle_falls_behind():
    follower, t_s = has_started(LINE), 0.0
    north = []
    for _ in range(60):
        t_s += 0.3
        target = np.empty((18, 2))
        follower.advance(knots(t_s), np.array(follower.target_m or STILL), (-0.3, 0.0), target)
        north.append((follower.target_m or STILL)[0])
    # 0.447 m/s through the water, 0.3 m/s of it against the current
    assert np.diff(north)[-20:] == pytest.approx(0.3 * (0.5 * 0.8**0.5 - 0.3), rel=1e-3)
    assert target[-1, 0] == pytest.approx(0.5 * 0.8**0.5 - 0.3, rel=1e-3)
    np.testing.assert_allclose(np.diff(target[:-1, 0]), np.diff(north)[-1], rtol=1e-3)


def test_a_nan_estimate_stops_the_target_and_a_valid_one_moves_it_again():
    follower = has_started(LINE)
    before = go(follower, 9.0, *go(follower, 8.7, 0.0, 0.0))
    go(follower, 9.3, math.nan, 0.0)
    assert follower.progress.cross_track_m is None
    assert go(follower, 9.6, math.nan, 0.0)[0] == pytest.approx(before[0] + 0.09, abs=0.02)
    assert go(follower, 9.9, *before) == go(follower, 9.9, *before)
    assert go(follower, 10.2, *before)[0] > before[0] + 0.1


def test_a_reference_does_not_start_at_a_non_finite_estimate():
    for reference in (LINE, Hold()):
        follower = Follower(reference, PAPER)
        assert not follower.begin(Estimate.at_rest(north_m=math.nan))
        assert follower.target_m is None
        assert follower.begin(Estimate.at_rest(north_m=1.0))


def test_after_a_gap_the_target_advances_by_at_most_one_step():
    follower = has_started(LINE)
    before = go(follower, 10.0, *go(follower, 9.7, 0.0, 0.0))
    for t_s in (10.3, 10.6):
        before = go(follower, t_s, *before)
    after = go(follower, 200.0, *before)
    assert 0.0 < after[0] - before[0] <= 0.3 * MAX_STEP_S + 1e-9


def test_the_leg_to_the_first_point_is_no_progress():
    follower, t_s, target = has_started(LINE, east_m=6.0), 0.0, (0.0, 6.0)
    for _ in range(40):
        t_s += 0.3
        target = go(follower, t_s, *target)
    assert target[0] == pytest.approx(0.0)
    assert 0.0 < target[1] < 6.0
    assert follower.progress.share == 0.0
    assert follower.progress.remaining_m == pytest.approx(12.0)


@pytest.mark.parametrize(("east_m", "sign"), [(0.2, 1.0), (-0.2, -1.0)])
def test_the_cross_track_error_is_of_the_vehicle_from_the_path(east_m, sign):
    follower = has_started(LINE)
    go(follower, 3.0, 0.4, east_m)
    assert follower.progress.cross_track_m == pytest.approx(sign * 0.2)


def test_a_point_and_here_have_no_progress_and_a_target_at_rest():
    for reference, from_m in ((Point(north_m=1.0, east_m=2.0), (4.0, 6.0)), (Hold(), (1.0, 2.0))):
        follower = has_started(reference, north_m=from_m[0], east_m=from_m[1])
        assert follower.start_distance_m == math.dist(from_m, (1.0, 2.0))
        assert go(follower, 5.0, 0.0, 0.0) == (1.0, 2.0)
        assert follower.progress == (None, None, None)
        target = np.full((18, 2), np.nan)
        follower.advance(knots(5.3), np.zeros(2), STILL, target)
        np.testing.assert_array_equal(target[:-1], np.tile([1.0, 2.0], (17, 1)))
        np.testing.assert_array_equal(target[-1], 0.0)


def test_depth_moves_to_the_path_at_the_maximum_rate_and_then_follows_it():
    deep = Line(
        speed_mps=0.3,
        start=Place(north_m=0.0, east_m=0.0, depth_m=2.0),
        end=Place(north_m=12.0, east_m=0.0, depth_m=2.6),
        descent_rate_mps=0.1,
    )
    follower = has_started(deep)
    go(follower, 3.0, 0.3, 0.0)
    depth, speed = follower.depths(knots(3.0)) or pytest.fail("no depth")
    np.testing.assert_allclose(depth, 0.1 * knots(3.0) * 1e-9)
    np.testing.assert_allclose(speed, 0.1)
    go(follower, 27.0, *(follower.target_m or STILL))
    t_s = 27.0
    for _ in range(20):
        t_s += 0.3
        target = go(follower, t_s, *(follower.target_m or STILL))
    depth, speed = follower.depths(knots(t_s)) or pytest.fail("no depth")
    assert depth[0] == pytest.approx(2.0 + 0.05 * target[0])
    assert speed[0] == pytest.approx(0.05 * 0.3, rel=1e-3)
    assert follower.depth_m == pytest.approx(2.6)


def test_a_timed_track_may_rest():
    follower = has_started(Timed(rows=((0.0, 1.0, 0.0), (40.0, 1.0, 0.0))), north_m=1.0)
    assert go(follower, 10.0, 1.0, 0.0) == (1.0, 0.0)
    assert follower.progress.remaining_m == 0.0


def test_a_restriction_that_changes_while_the_target_rests_keeps_its_stay():
    follower = has_started(Timed(rows=((10.0, 0.0, 0.0), (40.0, 6.0, 0.0), (100.0, 6.0, 0.0), (140.0, 12.0, 0.0))))
    at, t_s = {}, 0.0
    while t_s < 120.0:
        t_s = round(t_s + 0.5, 1)
        at[t_s] = go(follower, t_s, *(follower.target_m or STILL))
        if t_s in (20.0, 60.0, 80.0, 110.0):
            follower.restrict(lambda schedule: (schedule, 0.0))
    assert at[8.0] == pytest.approx((0.0, 0.0))
    assert at[25.0] == pytest.approx((3.0, 0.0))
    assert at[99.5] == pytest.approx((6.0, 0.0))
    assert at[120.0] == pytest.approx((9.0, 0.0))


def test_ahead_the_vehicle_is_on_the_line_to_its_point_as_early_as_possible():
    follower, lateral = has_started(Point(north_m=30.0, east_m=40.0)), np.zeros(6)
    cruise_mps = path_limits(PAPER).cruise_mps
    for current, speed_mps in ((STILL, cruise_mps), ((0.3, -0.4), cruise_mps + 0.5)):
        ahead = follower.places_ahead(lateral, current, np.array([0.0, 10.0, 1000.0]))
        assert ahead == pytest.approx(np.outer([0.0, 10.0 * speed_mps, 50.0], [0.6, 0.8]))
    there = follower.places_ahead(np.array([30.0, 40.0, 0.0]), STILL, np.array([0.0, 10.0]))
    assert there == pytest.approx(np.array([[30.0, 40.0], [30.0, 40.0]]))


def metres_in(vehicle: Vehicle, limit_mps: float, line: Line, current: np.ndarray, duration_s: float) -> float:
    """Return the progress (m) with a vehicle that heads for its target at its top speed at most."""
    follower, place = Follower(line, vehicle, limit_mps), np.zeros(2)
    top_mps = min(path_limits(vehicle).top_mps, limit_mps)
    assert follower.begin(Estimate.at_rest(depth_m=0.0))
    for k in range(round(duration_s / 0.3)):
        water = (np.array(go(follower, 0.3 * k, *place, tuple(current))) - place) / 0.3 - current
        place += 0.3 * (current + water * min(1.0, top_mps / max(math.hypot(*water), 1e-9)))
    return follower.progress.share * line.end.north_m


@pytest.mark.parametrize(
    ("name", "limit_mps", "direction"),
    [("paper", math.inf, (-1.0, 0.0)), ("surface", math.inf, (-0.6, 0.8)), ("paper", 0.25, (0.0, 1.0))],
)
def test_progress_is_what_the_current_leaves_and_never_more_in_a_stronger_one(name, limit_mps, direction):
    vehicle = Vehicle.load(name)
    top = min(path_limits(vehicle).top_mps, limit_mps)
    cruise, last = min(path_limits(vehicle).cruise_mps, 0.9 * limit_mps), math.inf
    line = Line(speed_mps=top, start=Place(north_m=0.0, east_m=0.0), end=Place(north_m=150.0 * top, east_m=0.0))
    for share in np.arange(0.1, 1.3, 0.06):
        current = share * top * np.array(direction)
        full, reduced = (
            math.sqrt(max(speed**2 - current[1] ** 2, 0.0)) + current[0] if share * top < speed else 0.0
            for speed in (top, cruise)
        )
        metres = metres_in(vehicle, limit_mps, line, current, 150.0)
        assert metres >= max(min(reduced, cruise), 0.95 * full if 0.87 < share < 0.98 else 0.0) * 140.0 - 0.05
        assert metres <= min(last, full * 150.0) + 0.05
        last = metres


@pytest.mark.parametrize(("known", "current_mps"), [(True, 0.4475), (False, 0.51)])
def test_against_a_current_progress_is_what_the_top_speed_leaves(known, current_mps):
    controller = Controller(PAPER, Line(speed_mps=0.5, start=LINE.start, end=Place(north_m=20.0, east_m=0.0)))
    water = CurrentProfile(depth_m=np.zeros(1), north_mps=np.array([-current_mps]), east_mps=np.zeros(1))
    estimate = msgspec.structs.replace(Estimate.at_rest(depth_m=0.0), current=water)
    for k in range(400):
        plan = controller.plan(estimate if known else msgspec.structs.replace(estimate, current=None))
        if k == 150:  # it has got up speed
            begin_m, from_m = 20.0 * plan.progress, estimate.north_m
        estimate = advance(PAPER, estimate, plan, duration_s=0.3)
    left_m = (0.5 - current_mps) * 75.0
    # On a straight course more current and more drag look alike, so one that is not told may be learned as both.
    assert 20.0 * plan.progress - begin_m == pytest.approx(max(left_m, 0.0), rel=0.08, abs=0.05 if known else 0.5)
    assert estimate.north_m - from_m == pytest.approx(left_m, rel=0.1, abs=0.1)  # too strong a current: full thrust
