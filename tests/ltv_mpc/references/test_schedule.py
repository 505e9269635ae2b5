"""Schedule: the speed along a path, against the equations of motion of the vehicle."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from ltv_mpc import references
from ltv_mpc.messages import ReferenceStart
from ltv_mpc.references import Circle, Line, Place, Waypoint, Waypoints
from ltv_mpc.references.limits import ACCELERATION_SHARE, SUSTAINED_SHARE, path_limits
from ltv_mpc.references.schedule import DEPTH, EAST, NORTH, TIME, WAY, feasible_rate, fill_targets, target_at
from ltv_mpc.vehicle.dynamics import rates
from ltv_mpc.vehicle.parameters import Vehicle
from tests.ltv_mpc.vehicles import changed

PAPER = Vehicle.load("paper")
LIMITS = path_limits(PAPER)
HERE = Place(north_m=0.0, east_m=0.0)
LINE = Line(speed_mps=0.3, start=HERE, end=Place(north_m=40.0, east_m=0.0))


def speeds(table):
    return np.diff(table[WAY]) / np.diff(table[TIME])


@pytest.mark.parametrize("radius_m", [2.0, 20.0])
def test_the_speed_of_a_bend_is_the_fastest_steady_turn_of_the_vehicle(radius_m):
    """The integrated equations of motion with the outer thruster at its limit settle on this circle."""
    speed = float(LIMITS.speed_at(np.array([1.0 / radius_m]))[0])
    assert speed < LIMITS.cruise_mps
    p = PAPER.coefficients()

    def circle(outer_N: float, inner_N: float) -> tuple[float, float]:
        u, v, psi, r = 0.1, 0.0, 0.0, 0.0
        for _ in range(3_000):
            _, _, du, dv, dpsi, dr = rates(u, v, psi, r, outer_N, inner_N, 0.0, 0.0, 0.0, 0.0, p)
            u, v, psi, r = u + 0.05 * du, v + 0.05 * dv, psi + 0.05 * dpsi, r + 0.05 * dr
        return math.hypot(u, v), math.hypot(u, v) / r

    # of the circles with the outer thruster at its share, the one of this radius
    outer = SUSTAINED_SHARE * 62.5
    low, high = -outer, outer  # more of the inner thruster, a wider circle
    for _ in range(14):
        inner = 0.5 * (low + high)
        low, high = (inner, high) if circle(outer, inner)[1] < radius_m else (low, inner)
    assert speed == pytest.approx(circle(outer, 0.5 * (low + high))[0], rel=0.02)


def test_the_schedule_starts_and_ends_at_rest_within_thrust_and_drag():
    table = LINE.schedule(PAPER).table
    v = speeds(table)
    assert v.max() == pytest.approx(0.3, rel=1e-6)
    assert v[0] < 0.1
    assert v[-1] < 0.1
    middle = 0.5 * (v[1:] + v[:-1])
    a = np.diff(v) / (0.5 * (np.diff(table[TIME])[1:] + np.diff(table[TIME])[:-1]))
    assert (
        500.0 * a <= np.minimum(ACCELERATION_SHARE * 125.0, SUSTAINED_SHARE * 125.0 - 500.0 * middle**2) * 1.1 + 1.0
    ).all()
    assert (500.0 * a >= -(ACCELERATION_SHARE * 125.0 + 500.0 * middle**2) * 1.1 - 1.0).all()


def test_a_straight_schedule_lasts_its_speed_plus_one_start_and_stop():
    """The closed form without drag is length / speed + v / 2 a at either end."""
    slow = Line(speed_mps=0.05, start=HERE, end=Place(north_m=40.0, east_m=0.0))
    a = ACCELERATION_SHARE * 125.0 / 500.0
    assert slow.schedule(PAPER).duration_s == pytest.approx(40.0 / 0.05 + 0.05 / a, abs=0.5)


def test_at_a_sharp_corner_the_target_waits_for_the_turning_time():
    places = (HERE, Place(north_m=20.0, east_m=0.0), Place(north_m=20.0, east_m=20.0))
    table = Waypoints(speed_mps=0.4, waypoints=places, corner_m=0.0).schedule(PAPER).table
    standing = np.diff(table[TIME])[np.diff(table[WAY]) == 0.0]
    assert standing.sum() == pytest.approx(float(LIMITS.turning_s(np.array(math.pi / 2))))
    # the equations of motion with F1 = -F2 at their share, there and back to rest, take about as long
    p, r, psi, t = PAPER.coefficients(), 0.0, 0.0, 0.0
    while psi < math.pi / 2:
        push = (
            SUSTAINED_SHARE * 62.5 if math.pi / 2 - psi > 0.5 * r * r / LIMITS.yaw_radps2 else -SUSTAINED_SHARE * 62.5
        )
        r += 0.01 * rates(0.0, 0.0, psi, r, push, -push, 0.0, 0.0, 0.0, 0.0, p)[5]
        psi, t = psi + 0.01 * r, t + 0.01
        assert t < 60.0
    assert t == pytest.approx(standing.sum(), rel=0.1)


ONE_WAY = changed(PAPER, {"thruster.port.min_N": 0.0, "thruster.starboard.min_N": 0.0})
"""The paper's vehicle without thrust astern."""


@pytest.mark.parametrize("vehicle", [PAPER, ONE_WAY], ids=["paper", "one way"])
@pytest.mark.parametrize("name", ["line", "square", "lawnmower", "circle", "spiral"])
@pytest.mark.parametrize("corner_m", [0.0, 0.4])
def test_every_schedule_advances_and_reaches_its_end(vehicle, name, corner_m):
    reference = msgspec.structs.replace(references.load(name), corner_m=corner_m)
    table = reference.schedule(
        vehicle,
        ReferenceStart(t_ns=0, north_m=30.0, east_m=-7.0, depth_m=0.0, heading_rad=2.0, velocity_mps=(0.3, 0.1)),
    ).table
    assert np.isfinite(table[:DEPTH]).all()
    assert (np.diff(table[TIME]) > 0.0).all()
    assert (np.diff(table[WAY]) >= 0.0).all()
    assert table[TIME, -1] < 20.0 * table[WAY, -1]
    np.testing.assert_allclose(table[[NORTH, EAST], 0], [30.0, -7.0])
    np.testing.assert_allclose(table[[NORTH, EAST], -1], reference.path().points[-1])
    np.testing.assert_allclose(np.hypot(*np.diff(table[[NORTH, EAST]])), np.diff(table[WAY]), atol=1e-9)


def test_waypoints_have_waits_depths_in_place_and_their_own_speeds():
    places = (
        Waypoint(north_m=0.0, east_m=0.0, depth_m=2.0),
        Waypoint(north_m=20.0, east_m=0.0, depth_m=2.0, speed_mps=0.1),
        Waypoint(north_m=20.0, east_m=20.0, depth_m=2.0, wait_s=20.0, speed_mps=0.2),
        Waypoint(north_m=20.0, east_m=20.0, depth_m=5.0, wait_s=4.0),
        Waypoint(north_m=0.0, east_m=20.0),
    )
    path = Waypoints(speed_mps=0.3, waypoints=places, descent_rate_mps=0.2)
    table = path.schedule(PAPER).table
    moving = speeds(table)[np.diff(table[WAY]) > 0.0]
    way = table[WAY, 1:][np.diff(table[WAY]) > 0.0]
    corner = path.path().lengths.sum() - 20.0  # up to the place with the depth
    for begin, end, speed in ((3.0, 15.0, 0.3), (corner - 16.0, corner - 4.0, 0.1), (corner + 4.0, corner + 16.0, 0.2)):
        inside = moving[(way > begin) & (way < end)]
        assert inside.max() == pytest.approx(speed, rel=1e-6)
    still = np.flatnonzero((np.diff(table[WAY]) == 0.0) & (np.diff(table[TIME]) > 0.0))
    rest_s, depth_m = np.diff(table[TIME])[still], np.diff(table[DEPTH])[still]
    turn_s = float(LIMITS.turning_s(np.array(math.pi / 2)))
    np.testing.assert_allclose(rest_s, [20.0, 3.0 / 0.2, 4.0 + turn_s])
    np.testing.assert_allclose(depth_m, [0.0, 3.0, 0.0])
    np.testing.assert_allclose(table[[NORTH, EAST]][:, still], [[20.0] * 3, [20.0] * 3])


def test_targets_agree_with_the_table_at_any_knots():
    circle = Circle(speed_mps=0.3, centre=HERE, radius_m=10.0)
    table = circle.schedule(PAPER).table
    knots = np.array([0, 0.3, 0.6, 1.5, 4.0, 11.0]) * 1e9
    target = np.empty((6, 2))
    fill_targets(table, 20.0, 0.5, knots.astype(np.int64), target)
    at = 20.0 + 0.5 * knots[1:] * 1e-9
    for column, row in ((0, NORTH), (1, EAST)):
        np.testing.assert_allclose(target[:-1, column], np.interp(at, table[TIME], table[row]), atol=1e-9)
    # half the speed, since half a second of the schedule passes in a second; the course is that of the circle
    assert math.hypot(*target[-1]) == pytest.approx(0.15, rel=0.01)
    assert abs(np.dot(target[-1], target[-2])) < 0.1 * 0.15 * 10.0
    fill_targets(table, 1e6, 1.0, knots.astype(np.int64), target)
    np.testing.assert_allclose(target[-1], 0.0)
    np.testing.assert_allclose(target[:-1], np.tile(table[[NORTH, EAST], -1], (5, 1)), atol=1e-12)
    assert target_at(table, 1e6)[0] == pytest.approx(table[WAY, -1])


def test_a_current_reduces_the_feasible_rate():
    table = LINE.schedule(PAPER).table  # 0.3 m/s northwards
    cruise = 0.4
    assert feasible_rate(table, 60.0, 5.0, 0.0, 0.0, cruise) == 1.0
    assert feasible_rate(table, 60.0, 5.0, 0.2, 0.0, cruise) == 1.0  # from astern
    assert feasible_rate(table, 60.0, 5.0, -0.2, 0.0, cruise) == pytest.approx(0.2 / 0.3)
    assert feasible_rate(table, 60.0, 5.0, 0.0, 0.3, cruise) == pytest.approx(math.sqrt(0.16 - 0.09) / 0.3)
    for north, east in ((-0.5, 0.0), (0.0, 0.5)):  # against and across, no rate is feasible
        assert feasible_rate(table, 60.0, 5.0, north, east, cruise) == 0.0
    assert feasible_rate(table, 60.0, 5.0, 0.5, 0.0, cruise) == 1.0


def test_a_later_leg_counts_only_at_rates_at_which_the_plan_reaches_it():
    corner = Waypoints(speed_mps=0.3, waypoints=(HERE, Place(north_m=40.0, east_m=0.0), HERE), corner_m=0.0)
    table = corner.schedule(PAPER).table  # northwards, a turn on the spot, and back
    back_s = float(table[TIME, np.flatnonzero(table[NORTH] == 40.0)[-1]])
    for before_s, rate in ((8.0, 0.8), (5.0, 0.5), (0.0, 0.0)):
        assert feasible_rate(table, back_s - before_s, 10.0, 0.42, 0.0, 0.4) == pytest.approx(rate, abs=0.02)
