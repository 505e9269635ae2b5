"""Paths through sampled points: the number of points, their noise and doubled points do not change the motion."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
import shapely
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from ltv_mpc.messages import Array, ReferenceStart
from ltv_mpc.references import Circle, Lawnmower, Line, Place, Reference, Timed, Waypoints
from ltv_mpc.references.leg_fit import fit_legs
from ltv_mpc.references.schedule import DEPTH, EAST, NORTH, TIME, WAY
from ltv_mpc.vehicle.parameters import Vehicle

PAPER, SURFACE = Vehicle.load("paper"), Vehicle.load("surface")
HERE = Place(north_m=0.0, east_m=0.0)
NOISE_M = 0.02
"""Largest noise of a coordinate: 1 % of the length of both vehicles."""

ANGLE = np.linspace(0.0, 2.0 * np.pi, 20_001)
RANDOM = np.random.default_rng(6).normal(size=(3, 2, 2)) * 5.0 / np.arange(1, 4)[:, None, None] ** 2.5
MOWER = Lawnmower(start=HERE, course_deg=0.0, length_m=20.0, width_m=12.0, spacing_m=4.0, speed_mps=1.0)
CURVES = {
    "circle": 3.0 * np.column_stack([np.cos(ANGLE), np.sin(ANGLE)]),
    "figure of eight": np.column_stack([8.0 * np.sin(ANGLE), 4.0 * np.sin(2.0 * ANGLE)]),
    "random curve": sum(
        np.outer(np.cos(k * ANGLE), a) + np.outer(np.sin(k * ANGLE), b) for k, (a, b) in enumerate(RANDOM, 1)
    ),
    "lawnmower": msgspec.structs.replace(MOWER, corner_m=0.0).path().points,
}
PATHS = CURVES | {"lawnmower": MOWER.path().points}
"""The curves with rounded corners."""


def waypoints(points: Array, speed_mps: float, **fields: object) -> Waypoints:
    places = tuple(Place(north_m=float(n), east_m=float(e)) for n, e in points)
    return Waypoints(waypoints=places, speed_mps=speed_mps, **fields)


def samples(curve: Array, count: int, noise_m: float = 0.0) -> Array:
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(curve, axis=0).T))])
    at = np.linspace(0.0, way[-1], count + 1)
    if len(curve) < 100:  # its corners are points too
        at = np.unique(np.concatenate([at, way]))
    points = np.column_stack([np.interp(at, way, column) for column in curve.T])
    return points + np.random.default_rng(count).uniform(-noise_m, noise_m, points.shape)


def off_curve_m(curve: Array, points: Array) -> float:
    return float(cKDTree(samples(curve, 20_000)).query(points)[0].max())


@pytest.mark.parametrize(("radius_m", "count"), [(1.0, 24), (3.0, 90), (1.0, 359), (3.0, 20_000)])
def test_a_circle_of_waypoints_takes_as_long_as_the_circle(radius_m, count):
    circle = Circle(centre=HERE, radius_m=radius_m, speed_mps=2.0).schedule(SURFACE)
    points = samples(CURVES["circle"] * radius_m / 3.0, count)
    assert waypoints(points, 2.0).schedule(SURFACE).duration_s == pytest.approx(circle.duration_s, rel=0.03)


@pytest.mark.parametrize(
    ("curve", "count"),
    [
        *(("circle", 361), ("figure of eight", 2_000), ("random curve", 361), ("lawnmower", 2_000)),
        *(("circle", 24), ("figure of eight", 24), ("random curve", 24), ("lawnmower", 90)),
    ],
)
def test_lap_time_and_path_do_not_depend_on_noise_and_number_of_points(curve, count):
    vehicle, speed_mps = (PAPER, 0.4) if count > 361 else (SURFACE, 2.0)
    exact = waypoints(samples(CURVES[curve], 720), speed_mps).schedule(vehicle)
    assert off_curve_m(PATHS[curve], exact.table[[NORTH, EAST]].T) < 0.02
    for noise_m in (0.0, 0.5 * NOISE_M, NOISE_M):
        schedule = waypoints(samples(CURVES[curve], count, noise_m), speed_mps).schedule(vehicle)
        assert schedule.duration_s == pytest.approx(exact.duration_s, rel=0.03)
        # Of 24 points those of the figure of eight are 2 m apart where its radius is 2 m.
        off_m = 0.022 if count > 24 else 0.055
        assert off_curve_m(PATHS[curve], schedule.table[[NORTH, EAST]].T) < off_m + 1.5 * noise_m


def test_sparse_points_that_turn_evenly_are_samples_of_a_curve_that_stays_near_their_lines():
    points = samples(CURVES["figure of eight"], 36)
    (note, *_), path = waypoints(points, 0.4).notes(PAPER), waypoints(points, 0.4).path()
    assert note.startswith("waypoints that turn evenly are samples of a curve: the path through them is up to 0.1")
    assert off_curve_m(path.points, points) < 0.02
    assert not waypoints(points, 0.4, corner_m=0.0).notes(PAPER)[0].startswith("waypoints that turn evenly")
    wide = waypoints(50.0 * points, 0.4)._fit()[1]
    assert wide.curve_m < 0.4
    hexagon = 3.0 * np.column_stack([np.cos(ANGLE), np.sin(ANGLE)])[:: len(ANGLE) // 6]
    np.testing.assert_allclose(waypoints(hexagon, 0.4)._fit()[1].ends[:, :2], hexagon, atol=1e-9)


@pytest.mark.parametrize("seed", [45, 69, 143])
def test_a_curve_through_samples_is_not_farther_from_their_lines_than_corner_m(seed: int) -> None:
    """The splines through these are up to 0.12 m from the lines."""
    heading = np.cumsum(np.cumsum(0.15 * np.random.default_rng(seed).normal(size=40)))
    points = np.cumsum(np.column_stack([np.cos(heading), np.sin(heading), np.zeros(40)]), axis=0)
    fit = fit_legs(points, 0.1)
    beside_m = shapely.distance(shapely.LineString(points[:, :2]), shapely.points(fit.ends[:, :2]))
    assert beside_m.max() < 0.1 + 0.02  # and what the fit of legs allows
    assert fit.curve_m == pytest.approx(0.1)


@pytest.mark.parametrize("beside", [(0.05, 0.0), (-0.05, 0.03), (0.0, -0.06)])
def test_a_corner_and_a_goal_that_are_doubled_within_centimetres_are_one(beside):
    corners = np.array([[0.0, 0.0], [20.0, 0.0], [20.0, 20.0]])
    once = waypoints(corners, 0.4).schedule(PAPER)
    doubled = waypoints(np.insert(corners, [2, 3], corners[[1, 2]] + beside, axis=0), 0.4)
    assert doubled.schedule(PAPER).duration_s == pytest.approx(once.duration_s, rel=0.01)
    assert off_curve_m(once.table[[NORTH, EAST]].T, doubled.path().points) < 0.07


def test_noise_and_the_steps_of_a_grid_planner_do_not_slow_the_vehicle_down():
    along = np.arange(0.0, 40.01, 0.05)
    noisy = np.column_stack([along, np.random.default_rng(0).normal(0.0, 0.002, len(along))])
    reference = waypoints(noisy, 0.4)
    assert reference.schedule(PAPER).duration_s == pytest.approx(100.0, rel=0.05)
    grid = np.cumsum([(0.05, 0.05 * (k % 2)) for k in range(400)], axis=0)
    reference = waypoints(grid, 0.4)
    assert reference.schedule(PAPER).duration_s == pytest.approx(math.hypot(20.0, 10.0) / 0.4, rel=0.08)
    (note,) = reference.notes(PAPER)
    assert note.startswith("the 400 waypoints scatter: the path of 1 legs smooths them and is up to 0.035 m away")


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.01, 0.4]), st.floats(-2.0, 1.0))
def test_no_waypoint_is_farther_from_the_legs_than_corner_m(seed, corner_m, exponent):
    """Walks at random, whose steps are small features rather than noise."""
    points = np.cumsum(np.random.default_rng(seed).normal(0.0, 10.0**exponent, (40, 3)), axis=0)
    fit = fit_legs(np.repeat(points, 2, axis=0), corner_m)
    assert fit.deviation_m <= max(corner_m, 0.02)
    assert (np.diff(fit.at) >= 0.0).all()


def test_a_corner_between_dense_points_is_that_between_sparse_points():
    points = np.array([[0.0, 0.0], [20.0, 0.0], [20.0, 20.0]])
    for corner_m in (0.0, 0.4, 2.0):
        sparse = waypoints(points, 0.4, corner_m=corner_m).path()
        dense = waypoints(samples(points, 4_000), 0.4, corner_m=corner_m).path()
        np.testing.assert_allclose(dense.points, sparse.points, atol=1e-6)


def test_a_path_back_along_itself_keeps_its_turning_points():
    north = np.concatenate([np.linspace(0.0, 10.0, 101), np.linspace(9.9, 5.0, 50), np.linspace(5.1, 20.0, 150)])
    path = waypoints(np.column_stack([north, 0.0 * north]), 0.4).path()
    np.testing.assert_allclose(path.points[:, 0], [0.0, 10.0, 5.0, 20.0], atol=1e-9)
    np.testing.assert_allclose(path.turn_on_spot, [0.0, math.pi, math.pi, 0.0])


@pytest.mark.parametrize("noise_m", [0.0, 0.005, NOISE_M])
def test_a_timed_track_of_a_noisy_log_keeps_its_times(noise_m):
    t = np.arange(0.0, 100.01, 0.1)
    for points in (np.column_stack([0.4 * t, 0.0 * t]), 10.0 * np.column_stack([np.cos(0.03 * t), np.sin(0.03 * t)])):
        noise = np.random.default_rng(0).normal(0.0, noise_m, points.shape)
        track = Timed(rows=tuple(map(tuple, np.column_stack([t, points + noise]).tolist())))
        table = track.schedule(PAPER).table
        assert table[TIME, -1] == pytest.approx(100.0, abs=0.2)
        assert np.hypot(*(table[[NORTH, EAST]].T - points).T).max() < 0.02 + 4.0 * noise_m


@pytest.mark.parametrize("rest_s", [40.0, 70.0])
@pytest.mark.parametrize("noise_m", [0.005, NOISE_M])
def test_a_noisy_log_with_a_long_rest_keeps_its_times(rest_s, noise_m):
    t = np.arange(0.0, 100.01, 0.1)
    points = np.column_stack([0.4 * np.minimum(t, 100.0 - rest_s), 0.0 * t])
    noise = np.random.default_rng(0).normal(0.0, noise_m, points.shape)
    table = Timed(rows=tuple(map(tuple, np.column_stack([t, points + noise]).tolist()))).schedule(PAPER).table
    assert table[TIME, -1] == pytest.approx(100.0, abs=0.2)
    assert np.hypot(*(table[[NORTH, EAST]].T - points).T).max() < 0.03 + 4.0 * noise_m


@pytest.mark.parametrize(
    ("rate_hz", "noise_m", "in_a_row"), [(1, 0.0, 1), (10, 0.0, 3), (10, 0.005, 1), (10, NOISE_M, 2)]
)
def test_outliers_of_a_log_do_not_delay_a_timed_track_and_are_named(rate_hz, noise_m, in_a_row):
    t = np.arange(0.0, 100.01, 1.0 / rate_hz)
    points = np.column_stack([0.4 * t, 0.0 * t])
    points += np.random.default_rng(0).normal(0.0, noise_m, points.shape)
    at = np.searchsorted(t, 50.0) + np.arange(in_a_row)
    for distance_m in (0.0, 3.0):
        points[at, 1] += distance_m
        track = Timed(rows=tuple(map(tuple, np.column_stack([t, points]).tolist())))
        table, notes = track.schedule(PAPER).table, track.notes(PAPER)
        assert (table[TIME] - t)[:: len(t) - 1] == pytest.approx(0.0, abs=0.2)
        assert np.abs(table[EAST]).max() < 0.02 + 4.0 * noise_m
        assert (f"{in_a_row} of {len(t)} rows are left out as outliers, up to 3.0 m" in "".join(notes)) == (
            distance_m > 0.0
        )
    assert f"t_s = {t[at[0]]:g}" in notes[0]
    path = waypoints(points, 0.4)
    assert path.notes(PAPER)[0].startswith(
        f"{in_a_row} waypoints are far beside those around them, the first is waypoints[{at[0]}]"
    )
    assert path.schedule(PAPER).duration_s < 100.0 + 50.0
    assert off_curve_m(path.path().points, points[at]) < 0.5


lengths = st.floats(-1.0, 6.0).map(lambda exponent: 10.0**exponent)
speeds = st.floats(-3.0, 1.3).map(lambda exponent: 10.0**exponent)


def references_of(length_m: float, speed_mps: float, rate_mps: float) -> list[Reference]:
    """One reference of each kind, of about this length."""
    deep = Place(north_m=length_m, east_m=0.0, depth_m=30.0)
    fields = {"speed_mps": speed_mps, "descent_rate_mps": rate_mps}
    corner = (Place(north_m=0.0, east_m=0.0, depth_m=0.0), deep, Place(north_m=length_m, east_m=length_m, depth_m=5.0))
    return [
        Line(start=corner[0], end=deep, **fields),
        Waypoints(waypoints=corner, **fields),
        Waypoints(waypoints=corner, corner_m=0.0, **fields),
        Circle(centre=HERE, radius_m=min(length_m, 1e5), depth_m=3.0, **fields),
        Timed(rows=((0.0, 0.0, 0.0, 0.0), (20.0, length_m, 0.0, 30.0)), descent_rate_mps=rate_mps),
    ]


anchors = st.floats(0.0, 2.0).map(
    lambda speed_mps: ReferenceStart(
        t_ns=0, north_m=0.0, east_m=0.0, depth_m=0.0, heading_rad=1.0, velocity_mps=(speed_mps, 0.0)
    )
)


@given(lengths, speeds, speeds, st.none() | anchors, st.sampled_from([PAPER, SURFACE]))
@example(40.0, 0.01, 0.02, None, PAPER)
@example(1e5, 0.2, 0.2, None, SURFACE)
@example(1.0, 0.05, 0.05, None, PAPER)
def test_no_reference_is_faster_or_sinks_faster_than_its_speeds(length_m, speed_mps, rate_mps, start, vehicle):
    for reference in references_of(length_m, speed_mps, min(rate_mps, 10.0)):
        steps = np.diff(reference.schedule(vehicle, start).table)
        assert (steps[TIME] >= 0.0).all()
        if not isinstance(reference, Timed):
            assert (steps[WAY] <= speed_mps * steps[TIME] * (1.0 + 1e-6) + 1e-9).all()
        assert (np.abs(steps[DEPTH]) <= reference.descent_rate_mps * steps[TIME] * (1.0 + 1e-6) + 1e-9).all()


def test_doubled_points_are_one_with_a_note():
    corners = np.array([[0.0, 0.0], [20.0, 0.0], [20.0, 20.0], [0.0, 20.0]])
    ring = np.vstack([corners[[0, 0, 1, 1, 1, 2, 3]], corners[:1]])
    for laps in (1, 2):
        doubled = waypoints(ring, 0.4, closed=True, laps=laps)
        once = waypoints(corners, 0.4, closed=True, laps=laps)
        np.testing.assert_allclose(doubled.path().points, once.path().points, atol=1e-9)
        assert doubled.notes(PAPER)[1:] == once.notes(PAPER)
        assert "count as one with it" in doubled.notes(PAPER)[0]
        assert doubled.notes(PAPER)[0].endswith("the first is waypoints[1]")
    goal = waypoints(corners[[0, 1, 1]], 0.4)
    np.testing.assert_allclose(goal.path().points, corners[:2])
