"""Path geometry: legs, rounded corners, curves."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ltv_mpc.references import Circle, Lawnmower, Line, Place, Spiral, Waypoints
from ltv_mpc.references.path import SAGITTA_M, Path, round_corners, with_lead_in

HERE = Place(north_m=0.0, east_m=0.0)


def corner(angle_rad: float, corner_m: float, leg_m: float = 20.0) -> Path:
    """Corner: northwards, then turned by an angle."""
    points = np.array([[-leg_m, 0.0], [0.0, 0.0], [leg_m * math.cos(angle_rad), leg_m * math.sin(angle_rad)]])
    return round_corners(points, np.full(3, math.nan), corner_m)


@given(st.floats(0.1, 2.5), st.floats(0.1, 2.0), st.booleans())
def test_a_corner_is_cut_by_at_most_corner_m(angle, corner_m, port):
    angle = -angle if port else angle
    path = corner(angle, corner_m)
    middles = 0.5 * (path.points[1:] + path.points[:-1])
    nearest = float(np.hypot(*np.concatenate([path.points, middles]).T).min())  # to the corner itself
    assert nearest <= corner_m + SAGITTA_M
    assert not path.turn_on_spot.any()


@given(st.floats(0.2, 2.5), st.floats(0.1, 2.0))
def test_a_rounded_corner_turns_evenly_with_its_curvature(angle, corner_m):
    path = corner(angle, corner_m)
    steps = np.diff(path.points, axis=0)
    course = np.arctan2(steps[:, 1], steps[:, 0])
    on_arc = path.curvature > 0.0
    assert path.turn[on_arc] == pytest.approx(angle)
    # chord c of an arc of radius R that turns by a: c = 2 R sin(a / 2)
    a = angle / np.count_nonzero(on_arc)
    np.testing.assert_allclose(path.lengths[on_arc], 2.0 / path.curvature[on_arc] * math.sin(0.5 * a), rtol=1e-6)
    assert np.abs(np.diff(course)).max() <= a + 1e-9


def test_a_short_leg_gets_smaller_arcs():
    path = corner(math.pi / 2, corner_m=5.0, leg_m=2.0)  # a radius of 12 m would be needed
    assert 1.0 / path.curvature.max() == pytest.approx(1.0)  # half a leg
    np.testing.assert_allclose(path.points[[0, -1]], [[-2.0, 0.0], [0.0, 2.0]], atol=1e-12)


def test_the_vehicle_stops_at_a_sharp_corner_and_at_a_reversal():
    assert corner(math.pi / 2, corner_m=0.0).turn_on_spot == pytest.approx([0.0, math.pi / 2, 0.0])
    back = round_corners(np.array([[0.0, 0.0], [10.0, 0.0], [0.0, 0.0]]), np.full(3, math.nan), 0.4)
    assert back.turn_on_spot == pytest.approx([0.0, math.pi, 0.0])


def test_a_distant_start_adds_a_straight_leg_to_the_path():
    path = corner(math.pi / 2, 0.4)
    same, none = with_lead_in(path, np.array([-20.1, 0.2]))
    assert none == 0.0
    assert same is path
    led, lead_m = with_lead_in(path, np.array([-20.0, -3.0]))
    assert lead_m == pytest.approx(3.0)
    assert led.length_m == pytest.approx(path.length_m + 3.0)
    assert led.turn_on_spot[1] == pytest.approx(math.pi / 2)  # from east to north


def test_a_closed_square_is_repeated_laps_times():
    places = tuple(Place(north_m=n, east_m=e) for n, e in ((0.0, 0.0), (20.0, 0.0), (20.0, 20.0), (0.0, 20.0)))
    once = Waypoints(speed_mps=1.0, waypoints=places, closed=True, corner_m=0.0).path()
    twice = Waypoints(speed_mps=1.0, waypoints=places, closed=True, corner_m=0.0, laps=2).path()
    assert (once.length_m, twice.length_m) == pytest.approx((80.0, 160.0))
    assert np.count_nonzero(twice.turn_on_spot) == 7


@pytest.mark.parametrize(("port", "last_east"), [(False, 20.0), (True, -20.0)])
def test_a_lawnmower_covers_its_width_on_the_requested_side(port, last_east):
    mower = Lawnmower(
        speed_mps=1.0, start=HERE, course_deg=0.0, length_m=40.0, width_m=20.0, spacing_m=5.0, port=port, corner_m=0.0
    )
    path = mower.path()
    assert path.length_m == pytest.approx(5 * 40.0 + 4 * 5.0)
    np.testing.assert_allclose(path.points[-1], [40.0, last_east], atol=1e-9)


@pytest.mark.parametrize("clockwise", [True, False])
def test_a_circle_keeps_its_radius_and_its_direction(clockwise):
    circle = Circle(speed_mps=1.0, centre=Place(north_m=3.0, east_m=-2.0), radius_m=7.0, turns=1.5, clockwise=clockwise)
    path = circle.path()
    np.testing.assert_allclose(np.hypot(*(path.points - [3.0, -2.0]).T), 7.0)
    assert path.length_m == pytest.approx(1.5 * 2 * math.pi * 7.0, rel=1e-3)
    assert path.curvature == pytest.approx(1 / 7.0)
    first = path.points[1] - path.points[0]  # from due north of the centre: clockwise is eastwards
    assert bool(first[1] > 0.0) is clockwise


def test_a_spiral_spans_its_radii_and_its_curvature_is_that_of_its_points():
    spiral = Spiral(speed_mps=1.0, centre=HERE, inner_m=4.0, outer_m=12.0, spacing_m=4.0)
    path = spiral.path()
    r = np.hypot(*path.points.T)
    assert (r[0], r[-1]) == pytest.approx((4.0, 12.0))
    assert (np.diff(r) > 0.0).all()
    steps = np.diff(path.points, axis=0)
    turn = np.diff(np.unwrap(np.arctan2(steps[:, 1], steps[:, 0])))
    measured = turn / (0.5 * (path.lengths[1:] + path.lengths[:-1]))
    np.testing.assert_allclose(measured, 0.5 * (path.curvature[1:] + path.curvature[:-1]), rtol=1e-3)
    back = msgspec.structs.replace(spiral, inwards=True).path()
    np.testing.assert_allclose(back.points, path.points[::-1])


def test_depths_between_waypoints_are_linear_along_the_path():
    places = (
        Place(north_m=0.0, east_m=0.0, depth_m=2.0),
        Place(north_m=10.0, east_m=0.0),
        Place(north_m=10.0, east_m=30.0, depth_m=10.0),
    )
    path = Waypoints(speed_mps=1.0, waypoints=places, corner_m=0.0).path()
    np.testing.assert_allclose(path.depth, [2.0, 4.0, 10.0])
    flat = Line(speed_mps=1.0, start=HERE, end=Place(north_m=1.0, east_m=0.0), depth_m=3.0).path()
    np.testing.assert_allclose(flat.depth, 3.0)
