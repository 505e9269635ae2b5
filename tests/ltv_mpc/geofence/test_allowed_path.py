"""Allowed part of a path: what is left out, and where the target continues."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.spatial import KDTree, cKDTree

from ltv_mpc.geofence import allowed_path as allowed_path_module
from ltv_mpc.geofence.allowed_path import STEP_M, Routes, allowed_path, divided, nearest_allowed
from ltv_mpc.geofence.fence import Fence
from ltv_mpc.geofence.route import SLACK_M, Router
from ltv_mpc.geofence.zones import Zones, are_clear, clearances, pack_zones
from ltv_mpc.messages import Array, Pair
from ltv_mpc.references import Line, Place, Timed, Waypoints
from ltv_mpc.references.schedule import EAST, NORTH, TIME, WAY, Schedule, target_at
from ltv_mpc.vehicle.parameters import Vehicle
from tests.ltv_mpc.geofence.shapes import contains, disc, fence_of, point, polygon, rings

PAPER = Vehicle.load("paper")


def line(south_m: float, north_m: float) -> Schedule:
    start, end = Place(north_m=south_m, east_m=0.0), Place(north_m=north_m, east_m=0.0)
    return Line(start=start, end=end, speed_mps=0.3).schedule(PAPER)


def discs(*of: tuple[float, float, float]) -> Zones:
    return pack_zones(Fence(margin_m=0.0, keep_out_disc=tuple(disc(*one) for one in of)))


ONE = discs((50.0, 3.0, 4.0))
NEED = np.ones(1)
CHORD_M = 2.0 * math.sqrt(5.0**2 - 3.0**2)
ARC_M = 10.0 * math.acos(3.0 / 5.0)
TANGENTS_M = 2.0 * math.sqrt(50.0**2 + 3.0**2 - 5.0**2) + 10.0 * (
    math.pi / 2 - math.atan(3.0 / 50.0) - math.acos(5.0 / math.hypot(50.0, 3.0))
)
"""Shortest way from the path's start to its end round the disc."""


def test_a_path_that_is_clear_or_has_no_allowed_point_near_it_stays_as_it_is() -> None:
    schedule, wall = line(0.0, 5.0), polygon(np.array([[0.0, 0.0], [0.0, 10.0], [10.0, 10.0], [10.0, 0.0]]))
    nowhere = Router(pack_zones(Fence(margin_m=0.0, keep_in=(wall,))), np.array([50.0]))
    for router in (Router(ONE, NEED), nowhere):
        assert allowed_path(schedule, router) == (schedule, 0.0)


class CountingRouter(Router):
    """Router that counts its searches."""

    searches = 0

    def way(self, start: Array, goal: Array, *, remember: bool = True) -> Array:
        self.searches += 1
        return super().way(start, goal, remember=remember)


def test_a_report_of_a_standing_obstacle_visits_the_path_near_it_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 3,000 waypoints as of 100. Far from the obstacle the columns are those of the path, later by the detour."""
    visits = []

    def counted(zones: Zones, need: Array, points: Array) -> Any:
        visits.append(len(points))
        return are_clear(zones, need, points)

    def near(tree: KDTree, place: list[float], radius_m: float) -> list[int]:
        visits.append(len(found := cKDTree.query_ball_point(tree, place, radius_m)))
        return found

    monkeypatch.setattr(KDTree, "query_ball_point", near)
    monkeypatch.setattr(allowed_path_module, "are_clear", counted)
    monkeypatch.setattr(allowed_path_module, "Router", CountingRouter)
    searches = []
    for count in (100, 3_000):
        places = tuple(Place(north_m=4.0 * k, east_m=0.5 * (k % 2)) for k in range(count))
        before, routes = Waypoints(waypoints=places, speed_mps=0.3).schedule(PAPER), Routes()
        routes.set_zones(discs((-100.0, 0.0, 5.0)), np.ones(1))
        routes.allowed_path(before)
        assert sum(visits) >= 16 * count
        for north_m in (50.0, 51.5):
            visits.clear()
            routes.set_standing(np.array([[north_m, 3.0, 5.0]]))
            after, _ = routes.allowed_path(before)
        assert isinstance(routes.router, CountingRouter)
        searches.append(routes.router.searches)
        assert 8.0 / STEP_M < sum(visits) < 10.0 / 0.05
        behind = divided(before.table)[:, -100:].copy()
        behind[TIME] += after.duration_s - before.duration_s
        np.testing.assert_allclose(after.table[:, -100:], behind)
    assert searches[0] == searches[1]


def test_the_target_takes_the_way_round_a_zone_at_the_speed_that_it_has_before_it() -> None:
    """Along a path of 0.3 m/s, a step of the table is 0.05 m."""
    before = line(0.0, 100.0)
    schedule, skipped_m = allowed_path(before, Router(ONE, NEED))
    assert skipped_m == pytest.approx(CHORD_M, abs=0.15)
    table = schedule.table
    points = np.ascontiguousarray(table[[NORTH, EAST]].T)
    assert (clearances(ONE, points) >= 1.0 - SLACK_M).all()
    steps = np.hypot(*np.diff(points, axis=0).T)
    assert steps.max() <= STEP_M
    beside = np.abs(points[:-1, 0] - 50.0) < 6.0
    assert (steps[beside] / np.diff(table[TIME])[beside]).max() == pytest.approx(0.3, abs=0.01)
    assert TANGENTS_M < steps.sum() < 100.0 - CHORD_M + ARC_M
    assert points[:, 1].min() == pytest.approx(-2.0, abs=0.3)  # the nearer side of the disc
    assert schedule.duration_s == pytest.approx(before.duration_s + (steps.sum() - 100.0) / 0.3, abs=0.5)
    assert schedule.length_m == before.length_m
    assert np.all(np.diff(table[TIME]) > 0.0)
    assert np.all(np.diff(table[WAY]) > 0.0)


@given(st.floats(0.005, 0.4), st.floats(0.01, 1.0), st.floats(0.0, 30.0), st.booleans())
def test_a_detour_is_no_faster_and_sinks_no_faster_than_the_path(
    speed_mps: float, rate_mps: float, depth_m: float, in_place: bool
) -> None:
    """The vehicle sinks on the way, or in the zone."""
    sinks = [Place(north_m=50.0, east_m=0.0, depth_m=z) for z in (0.0, depth_m)] if in_place else []
    ends = Place(north_m=0.0, east_m=0.0, depth_m=0.0), Place(north_m=100.0, east_m=0.0, depth_m=depth_m)
    path = Waypoints(waypoints=(ends[0], *sinks, ends[1]), speed_mps=speed_mps, descent_rate_mps=rate_mps)
    step_s, _, *step_m, sunk_m = np.diff(allowed_path(path.schedule(PAPER), Router(ONE, NEED))[0].table)
    assert (np.hypot(*step_m) <= speed_mps * step_s * (1.0 + 1e-6) + 1e-6).all()
    assert (np.abs(sunk_m) <= rate_mps * step_s * (1.0 + 1e-6) + 1e-6).all()


@pytest.mark.parametrize("begins_m", [45.0, 45.9])
def test_a_path_that_begins_in_front_of_a_zone_is_not_slow_round_it(begins_m: float) -> None:
    """The target begins at rest, and the zone begins at 46 m."""
    before = line(begins_m, 100.0)
    schedule, _ = allowed_path(before, Router(ONE, NEED))
    assert before.duration_s < schedule.duration_s < before.duration_s + 1.1 * (ARC_M - CHORD_M) / 0.3


@pytest.mark.parametrize(("begins_m", "ends_m"), [(0.0, 54.02), (0.0, 55.0), (45.98, 100.0)])
def test_a_path_that_begins_or_ends_beside_a_zone_begins_and_ends_there(begins_m: float, ends_m: float) -> None:
    """The zone is from 46 to 54 m; of 54.02 m only the last column is allowed, from 45.98 m on only the first one."""
    schedule, skipped_m = allowed_path(line(begins_m, ends_m), Router(ONE, NEED))
    np.testing.assert_allclose(schedule.table[[NORTH, EAST], 0], [begins_m, 0.0], atol=1e-9)
    np.testing.assert_allclose(schedule.table[[NORTH, EAST], -1], [ends_m, 0.0], atol=1e-9)
    assert skipped_m == pytest.approx(CHORD_M, abs=0.15)
    points = np.ascontiguousarray(schedule.table[[NORTH, EAST]].T)
    assert (clearances(ONE, points) >= 1.0 - SLACK_M).all()
    assert np.hypot(*np.diff(points, axis=0).T).max() <= STEP_M


def behind_a_wall(north_m: float) -> Router:
    """Return the router of a basin that a wall of 4 m, which begins there, divides."""
    basin = polygon(np.array([[-10.0, -10.0], [-10.0, 10.0], [110.0, 10.0], [110.0, -10.0]]))
    wall = polygon(np.array([[north_m + n, e] for n, e in ((0.0, -12.0), (0.0, 12.0), (4.0, 12.0), (4.0, -12.0))]))
    return Router(pack_zones(Fence(margin_m=0.0, keep_in=(basin,), keep_out=(wall,))), np.ones(2))


def test_where_no_way_leads_round_a_zone_the_target_jumps() -> None:
    before = line(0.0, 100.0)
    schedule, skipped_m = allowed_path(before, behind_a_wall(48.0))
    assert skipped_m == pytest.approx(6.0, abs=0.15)
    table = schedule.table
    k = int(np.argmax(np.diff(table[WAY])))
    assert table[NORTH, k] == pytest.approx(47.0, abs=0.06)
    assert table[NORTH, k + 1] == pytest.approx(53.0, abs=0.06)
    assert table[TIME, k] == table[TIME, k + 1]
    assert target_at(table, float(table[TIME, k]) - 1e-6)[1] < 50.0 < target_at(table, float(table[TIME, k]))[1]
    assert schedule.duration_s == pytest.approx(before.duration_s - 6.0 / 0.3, abs=1.0)


def test_a_path_begins_at_the_exit_and_ends_at_the_nearest_allowed_point() -> None:
    """One that lies inside becomes a point; what is skipped is the distance by which its end is moved."""
    begins, ends, inside = (allowed_path(line(*of), Router(ONE, NEED)) for of in ((50, 100), (0, 50), (49, 50)))
    table = begins[0].table
    assert table[TIME, 0] == 0.0
    assert table[NORTH, 0] == pytest.approx(50.0 + CHORD_M / 2, abs=0.06)
    for schedule, _ in (ends, inside):
        np.testing.assert_allclose(schedule.table[[NORTH, EAST], -1], [50.0, -2.0], atol=1e-4)
    assert inside[0].duration_s == 0.0
    assert begins[1] == pytest.approx(CHORD_M / 2, abs=0.1)
    assert ends[1] == pytest.approx(CHORD_M / 2, abs=0.1)
    assert inside[1] == pytest.approx(2.0, abs=1e-4)


@given(rings(), point)
def test_the_nearest_allowed_point_is_allowed_and_no_ray_finds_a_nearer_one(ring: Array, at: Pair) -> None:
    zones, need = pack_zones(fence_of(ring, keep_in=False)), np.array([0.5])
    found = nearest_allowed(zones, need, at)
    assert found is not None
    assert clearances(zones, np.array([found]))[0, 0] >= 0.5
    moved = math.dist(found, at)
    if not contains(ring, np.array(at)):  # it leads straight away from the boundary
        assert moved <= 0.5 + 1e-5 or clearances(zones, np.array([at]))[0, 0] < 0.5
    if moved < 1e-5:  # nothing but rounding
        return
    angle = np.linspace(0.0, 2.0 * np.pi, 60)
    near = np.array(at) + 0.9 * moved * np.column_stack([np.cos(angle), np.sin(angle)])
    allowed = clearances(zones, near)[:, 0] >= 0.5
    assume(len(ring) == 3)  # for a triangle the projection is exact
    assert not allowed.any()


def test_between_walls_that_are_too_close_the_allowed_point_is_found_too() -> None:
    notch = np.array([[0.0, 0.0], [0, 10], [10, 10], [10, 5.5], [1, 5.5], [1, 4.5], [10, 4.5], [10, 0]])
    zones = pack_zones(fence_of(notch, keep_in=False))
    found = nearest_allowed(zones, np.ones(1), (5.0, 5.1))
    assert found is not None
    assert clearances(zones, np.array([found]))[0, 0] >= 1.0
    assert math.dist(found, (5.0, 5.1)) < 6.3  # to the east of all walls it is 5.9 m
    nowhere = Fence(margin_m=0.0, keep_in=(polygon(notch),))
    assert nearest_allowed(pack_zones(nowhere), np.array([50.0]), (5.0, 5.1)) is None


def test_a_leg_between_two_distant_rows_does_not_step_over_a_zone() -> None:
    track = Timed(rows=((0.0, 0.0, 0.0), (100.0, 10.0, 0.0), (1000.0, 100.0, 0.0))).schedule(PAPER)
    assert track.table.shape[1] == 3
    schedule, skipped_m = allowed_path(track, Router(ONE, NEED))
    assert skipped_m == pytest.approx(CHORD_M, abs=0.6)
    assert 1000.0 < schedule.duration_s < 1000.0 + 10.0 * (ARC_M - CHORD_M)
    assert target_at(schedule.table, 200.0)[1] == pytest.approx(20.0)


def test_a_path_with_one_allowed_point_is_a_point() -> None:
    zones = pack_zones(
        Fence(margin_m=0.0, keep_in=(polygon(np.array([[9.0, -1.0], [9.0, 5.0], [11.0, 5.0], [11.0, -1.0]])),))
    )
    track = Timed(rows=((0.0, 9.8, 2.0), (10.0, 10.0, 2.0))).schedule(PAPER)
    schedule, _ = allowed_path(track, Router(zones, np.array([1.0])))
    assert (schedule.table[NORTH] == 10.0).all()
    assert (schedule.table[EAST] == 2.0).all()
    assert schedule.duration_s == 10.0


STAY = Timed(rows=((0.0, 0.0, 0.0), (40.0, 12.0, 0.0), (100.0, 12.0, 0.0), (180.0, 30.0, 0.0)))
"""Track with a stay of 60 s at 12 m."""


def test_a_stay_in_a_zone_keeps_its_time_at_the_exit() -> None:
    """The disc reaches from 9 to 15 m, with the required clearance from 8 to 16 m: the stay is in it."""
    before = STAY.schedule(PAPER)
    schedule, skipped_m = allowed_path(before, Router(discs((12.0, 0.5, 3.0)), NEED))
    assert skipped_m == pytest.approx(2.0 * math.sqrt(4.0**2 - 0.5**2), abs=0.6)
    assert schedule.duration_s == pytest.approx(180.0)
    for t_s in (5.0, 20.0, 125.0, 140.0, 170.0):  # before the zone and behind it each place has its time
        np.testing.assert_allclose(target_at(schedule.table, t_s), target_at(before.table, t_s), atol=1e-9)
    exit_m = target_at(schedule.table, 100.0)[1]
    assert 15.5 < exit_m < 20.5
    assert target_at(schedule.table, 80.0)[1] == exit_m  # it went round the zone at 0.3 m/s, and waits
    assert np.all(np.diff(schedule.table[TIME]) >= 0.0)


def test_a_late_timed_target_is_in_time_again_behind_a_stay_in_a_zone() -> None:
    track = Timed(rows=((0.0, -100.0, 0.0), (400.0, 0.0, 0.0), *((t + 400.0, n, e) for t, n, e in STAY.rows[1:])))
    wide, small = (-50.0, 0.0, 5.0), (12.0, 0.5, 3.0)
    late, _ = allowed_path(track.schedule(PAPER), Router(discs(wide), NEED))
    assert 590.0 < late.duration_s < 610.0
    in_time, _ = allowed_path(track.schedule(PAPER), Router(discs(wide, small), np.ones(2)))
    assert in_time.duration_s == pytest.approx(580.0)


def test_where_no_way_leads_round_a_zone_a_timed_target_jumps_and_waits() -> None:
    schedule, _ = allowed_path(STAY.schedule(PAPER), behind_a_wall(10.0))
    assert target_at(schedule.table, 29.0)[1] == pytest.approx(8.7)
    assert target_at(schedule.table, 31.0)[1] == target_at(schedule.table, 100.0)[1] == pytest.approx(15.0, abs=0.3)
    assert schedule.duration_s == 180.0


@pytest.mark.parametrize(("centre_m", "waits_s", "at_m"), [(0.0, (0.0, 15.0), 5.0), (30.0, (165.0, 180.0), None)])
def test_a_timed_track_whose_end_is_in_a_zone_rests_there(centre_m: float, waits_s: Pair, at_m: float | None) -> None:
    """The disc and the required clearance have 5 m: the target waits behind them, or beside the end."""
    schedule, _ = allowed_path(STAY.schedule(PAPER), Router(discs((centre_m, 1.0, 4.0)), NEED))
    assert schedule.table[TIME, 0] == 0.0
    assert schedule.duration_s == 180.0
    begin, end = (target_at(schedule.table, t_s)[1:] for t_s in waits_s)
    assert begin == end
    if at_m is not None:
        assert begin == pytest.approx((at_m, 0.0), abs=0.3)
    else:
        np.testing.assert_allclose(begin, [30.0, -4.0], atol=1e-4)
