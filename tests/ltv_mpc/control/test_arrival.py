"""Arrival: the vehicle at the end of its reference, and not its target alone."""

from __future__ import annotations

import msgspec
import pytest

from ltv_mpc import Controller, ControllerConfig, Estimate, Vehicle, references
from ltv_mpc.control.config import Disturbance
from ltv_mpc.control.node import ControllerNode
from ltv_mpc.messages import Action, Command, ControllerState, Plan
from ltv_mpc.node import ReceivedMessage
from tests.ltv_mpc.control.flights import fly

PAPER = Vehicle.load("paper")
PLACE = references.Place
LINE = references.Line(start=PLACE(north_m=0.0, east_m=0.0), end=PLACE(north_m=3.0, east_m=0.0), speed_mps=0.4)
POINT = references.Point(north_m=3.0, east_m=0.0)
DEEP = references.Point(north_m=0.0, east_m=0.0, depth_m=4.0)
START = msgspec.structs.replace(Estimate.at_rest(), depth_m=None)


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
    for north_m, arrives in ((0.0, False), (2.45, False), (2.55, True)):
        controller = Controller(Vehicle.load("surface"), LINE, unknown)
        for i in range(200):
            plan = controller.plan(at(START, north_m, 0.3 * i))
        assert (plan.progress, plan.arrived) == (1.0, arrives)
    assert controller.plan(at(START, 0.5, 60.0)).arrived  # it stays


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
    node = ControllerNode(PAPER, POINT, ControllerConfig())

    def cycle(node, t_ns, *messages):
        return node.step(t_ns, [ReceivedMessage(message, 1, t_ns + i, t_ns) for i, message in enumerate(messages)])

    def plan_of(outputs):
        return next(message for message in outputs if isinstance(message, Plan))

    arm = Command(command_id=1, action=Action.ARM)
    assert not plan_of(cycle(node, 0, at(START, 2.0, 0.0), arm)).arrived
    assert plan_of(cycle(node, 300_000_000, at(START, 2.9, 0.3))).arrived
    outputs = cycle(node, 5_400_000_000, at(START, 2.9, 5.4))
    (state,) = (message for message in outputs if isinstance(message, ControllerState))
    assert state.arrived
    other = ControllerNode(PAPER, POINT, ControllerConfig())
    assert plan_of(cycle(other, 5_700_000_000, state, at(START, 1.0, 5.7))).arrived
    cycle(other, 6_000_000_000, at(START, 1.0, 6.0), Command(command_id=2, action=Action.DISARM))
    assert not plan_of(cycle(other, 6_300_000_000, at(START, 1.0, 6.3), arm)).arrived
