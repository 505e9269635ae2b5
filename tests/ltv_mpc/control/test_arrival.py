"""The vehicle and its target: arrival at the end of a reference, and a vehicle that does not get nearer."""

from __future__ import annotations

import msgspec
import pytest

from ltv_mpc import Controller, ControllerConfig, Estimate, Vehicle, references
from ltv_mpc.control.config import Disturbance
from ltv_mpc.control.controller import STAYS_AWAY
from ltv_mpc.control.mode import NO_DEPTH
from ltv_mpc.messages import Action, Command
from ltv_mpc.references.follower import Follower
from tests.ltv_mpc.control.flights import ARM, Flight, at_rest, fly

PAPER = Vehicle.load("paper")
PLACE = references.Place
LINE = references.Line(start=PLACE(north_m=0.0, east_m=0.0), end=PLACE(north_m=3.0, east_m=0.0), speed_mps=0.4)
POINT = references.Point(north_m=3.0, east_m=0.0)
DEEP = references.Point(north_m=0.0, east_m=0.0, depth_m=4.0)
START = msgspec.structs.replace(Estimate.at_rest(), depth_m=None)
AGAINST, CARRIED = (msgspec.structs.replace(at_rest(north_mps), depth_m=None) for north_mps in (0.3, 0.7))
"""In a current to the north, weaker and stronger than the vehicle."""
ACROSS = references.Line(start=PLACE(north_m=0.0, east_m=0.0), end=PLACE(north_m=0.0, east_m=30.0), speed_mps=0.2)


def at(estimate: Estimate, north_m: float, t_s: float, **changes: float) -> Estimate:
    return msgspec.structs.replace(estimate, north_m=north_m, t_ns=round(t_s * 1e9), **changes)


@pytest.mark.parametrize("reference", [LINE, POINT])
def test_it_arrives_once_within_half_a_metre_of_the_end(reference):
    way, plans = fly(Controller(PAPER, reference), START, 134)
    arrived, north_m = [plan.arrived for plan in plans], [START.north_m, *(estimate.north_m for estimate in way)]
    first = arrived.index(True)
    assert 2.5 - 0.2 <= north_m[first] <= 3.01  # at most the way of one cycle later
    assert north_m[first - 1] < 2.5 + (reference is LINE)  # and not before the target
    assert all(arrived[first:])


def test_a_vehicle_held_short_of_the_end_has_not_arrived_although_its_target_has():
    """A current, which is not known to the controller, holds the boat where it is."""
    unknown = ControllerConfig(disturbance=Disturbance(sd_mps=0.0))
    controller = Controller(Vehicle.load("surface"), LINE, unknown)
    for i in range(200):
        plan = controller.plan(at(START, 2.45, 0.3 * i))
    assert (plan.progress, plan.arrived) == (1.0, False)
    assert controller.plan(at(START, 2.55, 60.0)).arrived
    assert controller.plan(at(START, 0.5, 60.3)).arrived  # it stays


def test_a_round_that_ends_where_it_begins_has_not_arrived_at_its_start():
    corners = tuple(PLACE(north_m=north_m, east_m=east_m) for north_m, east_m in ((0.0, 0.0), (9.0, 0.0), (9.0, 9.0)))
    assert (
        not Controller(PAPER, references.Waypoints(waypoints=corners, closed=True, speed_mps=0.4)).plan(START).arrived
    )


def test_the_tolerance_of_the_position_is_the_radius_if_it_is_larger():
    for tolerance_m, arrives in ((0.2, False), (2.0, False), (2.2, True)):
        controller = Controller(PAPER, POINT, ControllerConfig(position_tolerance_m=tolerance_m))
        assert controller.plan(at(START, 0.9, 0.0)).arrived is arrives


def test_the_end_has_a_depth_for_a_vehicle_that_dives():
    controller = Controller(PAPER, DEEP)
    for t_s, depth_m, arrived in ((0.0, 3.4, False), (0.3, 3.6, True)):
        assert controller.plan(at(START, 0.0, t_s, depth_m=depth_m)).arrived is arrived
    boat = Controller(Vehicle.load("surface"), DEEP)
    assert boat.plan(START).arrived
    assert not Controller(PAPER, DEEP).plan(START).arrived  # at an unknown depth


def test_a_late_estimate_is_no_arrival():
    controller = Controller(PAPER, POINT)
    controller.plan(START)
    assert not controller.plan(at(START, 2.9, 0.3), t_ns=2_000_000_000).arrived
    assert controller.plan(at(START, 2.9, 2.3)).arrived


def test_another_reference_and_a_hold_of_the_policy_reset_and_keep_it():
    controller = Controller(PAPER, POINT)
    assert controller.plan(at(START, 2.9, 0.0)).arrived
    controller.pause(START)
    assert controller.plan(at(START, 2.9, 0.3)).arrived
    controller.resume()
    controller.follow(references.Point(north_m=9.0, east_m=0.0))
    assert not controller.plan(at(START, 2.9, 0.6)).arrived
    controller.follow(POINT)
    assert controller.plan(at(START, 2.9, 0.9)).arrived


def test_a_controller_that_continues_has_arrived_and_an_armed_one_begins_again():
    flight = Flight(POINT)
    assert not flight.run(0, at(START, 2.0, 0.0), ARM).arrived
    assert flight.run(300_000_000, at(START, 2.9, 0.3)).arrived
    flight.run(5_400_000_000, at(START, 2.9, 5.4))
    assert flight.states[-1].arrived
    other = Flight(POINT)
    assert other.run(5_700_000_000, flight.states[-1], at(START, 1.0, 5.7)).arrived
    other.run(6_000_000_000, at(START, 1.0, 6.0), Command(command_id=2, action=Action.DISARM))
    assert not other.run(6_300_000_000, at(START, 1.0, 6.3), ARM).arrived


def why_not_nominal(reference: references.Reference, start: Estimate, seconds: float) -> list[tuple[float, str]]:
    """Return time and reason of each change of the health in a flight."""
    _, plans = fly(Controller(PAPER, reference), start, round(seconds / 0.3))
    found, last = [], ""
    for plan in plans:
        if plan.health_why != last:
            found.append((plan.cycle_t_ns * 1e-9, plan.health_why))
            last = plan.health_why
    return found


def test_health_says_it_while_a_vehicle_is_carried_away_from_its_target():
    """The current is stronger than the vehicle, at a point and across a line."""
    for reference in (references.Point(north_m=0.0, east_m=0.0), ACROSS):
        ((t_s, why),) = why_not_nominal(reference, CARRIED, 45.0)
        assert why.startswith(STAYS_AWAY)
        assert 30.0 <= t_s < 40.0


@pytest.mark.parametrize(
    ("reference", "start", "seconds"),
    [
        (references.Point(north_m=-8.0, east_m=0.0), AGAINST, 75.0),  # it comes nearer slowly
        (DEEP, START, 45.0),
    ],
)
def test_health_is_nominal_on_the_way_and_at_the_target(reference, start, seconds):
    assert why_not_nominal(reference, start, seconds) in ([], [(0.0, NO_DEPTH)])


def test_a_vehicle_that_comes_back_is_nominal_again_and_one_that_oscillates_far_away_is_not():
    follower = Follower(POINT, PAPER)
    assert follower.begin(START)
    steps = [(t, 9.0) for t in range(31)] + [(31, 8.5), (32, 8.1), (33, 8.4), (34, 7.9)]
    stays = []
    for t_s, distance_m in steps:
        follower.watch(at(START, 3.0 + distance_m, t_s), 0.0)
        stays.append(follower.stays_away)
    assert stays == [False] * 30 + [True] * 4 + [False]
    follower.watch(at(START, 20.0, 35.0), 0.0)
    assert follower.stays_away
    follower.watch(at(START, 20.0, 40.0), 0.0)  # somebody else drove, or it went round a zone
    assert not follower.stays_away
