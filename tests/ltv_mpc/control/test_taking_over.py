"""Change of command authority in a closed loop: thrust never jumps."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from ltv_mpc import Plan, Vehicle, references
from ltv_mpc.messages import Action, Command, Manual
from ltv_mpc.safety.plan_gate import PlanGate, PlanVerdict
from tests.ltv_mpc.control.flights import Flight, armed

POINT = references.Point(north_m=0.0, east_m=0.0, depth_m=10.0)
STICK = Manual(thrust_N=(40.0, -40.0, 20.0))
"""From the first "manual" on a hand is on the stick."""
ARM, DISARM, STOP, MANUAL, RELEASE = Action.ARM, Action.DISARM, Action.STOP, Action.MANUAL, Action.RELEASE


def give(flight: Flight, action: Action, cycles: int = 10) -> Plan:
    """Give an order, and fly on for some cycles; return the plan of the first."""
    plan = flight.step(Command(command_id=len(flight.answers) + 1, action=action), STICK)
    for _ in range(cycles):
        flight.step(STICK)
    return plan


def check_no_jump(plans: list[Plan]) -> None:
    """Each plan begins at the command in force, and actuators follow it as it is."""
    gate = PlanGate(Vehicle.load("paper"))
    for before, after in pairwise(plans):
        np.testing.assert_allclose(after.thrust_N[0], before.thrust_at(int(after.t_ns[0])), atol=1e-6)
    for k, plan in enumerate(plans):
        assert gate.offer(plan, 1, k, int(plan.t_ns[0])) is PlanVerdict.ACCEPTED


@pytest.mark.parametrize(
    ("before", "action", "ends"),
    [
        ([], DISARM, "disarmed"),
        ([], STOP, "stopped"),
        ([], MANUAL, "manual"),
        ([MANUAL], RELEASE, "controller"),
        ([MANUAL], STOP, "stopped"),
        ([DISARM], ARM, "controller"),
        ([STOP], ARM, "controller"),
    ],
)
def test_the_thrusters_change_hands_without_a_jump(before: list[Action], action: Action, ends: str) -> None:
    flight = armed(POINT, 10)
    for order in (*before, action):
        give(flight, order)
    assert all(answer.accepted for answer in flight.answers)
    last = flight.plans[-1]
    assert flight.answers[-1].authority == last.authority == ends
    check_no_jump(flight.plans)
    if ends == "controller":
        assert last.origin == "solved"
        assert last.reference_m is not None
        assert np.abs(last.thrust_N).max() > 1.0
    else:
        np.testing.assert_allclose(last.thrust_N[0], STICK.thrust_N if ends == "manual" else np.zeros(3))


def test_a_reference_message_is_followed_and_an_invalid_one_rejected_with_reason() -> None:
    flight, there = armed(POINT, 3), 'kind = "point"\nnorth_m = 3.0\neast_m = -2.0\n'
    for toml, why in (
        (there.replace("3.0", "1e9"), "north_m = 1000000000.0: must be >= -1000000"),
        ("kind = ", "TOML"),
        ('kind = "timed"\nfile = "/etc/passwd"\n', "cannot name a file"),
        (there, ""),
    ):
        flight.step(Command(command_id=7, action=Action.FOLLOW, reference_toml=toml))
        assert why in flight.answers[-1].why
        assert flight.answers[-1].accepted == (toml == there)
    assert flight.step().reference_m == (3.0, -2.0)
    check_no_jump(flight.plans)


def test_hold_keeps_the_place_and_the_depth_of_the_command_and_arm_begins_anew() -> None:
    flight = armed(POINT, 10)
    depth_m = flight.estimate.depth_m
    before = give(flight, Action.HOLD, 6)
    give(flight, DISARM, 6)
    after = give(flight, ARM, 0)
    assert np.hypot(*np.subtract(before.reference_m, before.states[0, :2])) < 0.05
    assert np.hypot(*np.subtract(after.reference_m, before.reference_m)) > 1e-4
    assert before.reference_depth_m == after.reference_depth_m == pytest.approx(depth_m, abs=0.1)
