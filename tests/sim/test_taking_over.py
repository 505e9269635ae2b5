"""Change of command authority in a closed loop: thrust never jumps."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
import numpy as np
import pytest

from ltv_mpc import references
from ltv_mpc.control.node import ControllerNode
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.messages import Acknowledgement, Action, Applied, Command, Manual, Message, Plan
from ltv_mpc.node import Grid, Inbox, ReceivedMessage
from ltv_mpc.vehicle.parameters import Vehicle
from sim.plant import Plant
from sim.scenario import Scenario
from sim.scheduler import LockStep, Observation
from sim.sensors.node import Sensors
from sim.water import make

S = 1_000_000_000
VEHICLE = Vehicle.load("paper")  # +-62.5 N, 100 N/s
DELAY_NS = 50_000_000


class Operator:
    """Gives each command at its time; from the first "manual" on its hand is on the stick."""

    name = "operator"
    schedule = Grid(100_000_000)
    reads: tuple[type[Message], ...] = (Acknowledgement,)
    writes: tuple[type[Message], ...] = (Command, Manual)

    def __init__(self, orders: dict[float, Command], stick: tuple[float, float, float] | None) -> None:
        self.orders = {round(t * S): command for t, command in orders.items()}
        self.stick = stick
        self.answers: list[Acknowledgement] = []

    def step(self, t_ns: int, inbox: Inbox) -> Sequence[Message]:
        self.answers += [arrival.message for arrival in inbox]
        said: list[Message] = [self.orders[t_ns]] if t_ns in self.orders else []
        return [*said, Manual(thrust_N=self.stick)] if self.stick else said


class Seen:
    """Observer that keeps messages by type."""

    def __init__(self) -> None:
        self.applied: list[Applied] = []
        self.plans: list[Plan] = []

    def published(self, _node: str, message: ReceivedMessage) -> None:
        match message.message:
            case Applied() as applied:
                self.applied.append(applied)
            case Plan() as plan:
                self.plans.append(plan)


def fly(orders: dict[float, Command | Action], until_s: float, *, stick=None) -> tuple[Seen, list[Acknowledgement]]:
    base = Scenario.load("descent")
    scenario = msgspec.structs.replace(base, run=msgspec.structs.replace(base.run, perfect_state=True, arm=True))
    water = make(scenario.water, 0)
    commands = {
        t: Command(command_id=k, action=order) if isinstance(order, Action) else order
        for k, (t, order) in enumerate(orders.items())
    }
    operator, seen = Operator(commands, stick), Seen()
    nodes = [
        Plant(scenario, VEHICLE, water),
        Sensors(scenario, SensorConfig.load("paper"), water),
        operator,
        ControllerNode(VEHICLE, references.load("descent"), scenario.controller),
    ]
    lockstep = LockStep(nodes, start_ns=scenario.start_ns, compute_delay_ns=DELAY_NS, observation=Observation(seen))
    lockstep.advance(round(until_s * S))
    return seen, operator.answers


def authority_at(seen: Seen, t_s: float) -> str:
    return next(plan for plan in reversed(seen.plans) if plan.t_ns[0] <= t_s * S).authority


def command_at(seen: Seen, t_s: float) -> np.ndarray:
    return np.array(next(x for x in seen.applied if x.t_ns == round(t_s * S)).command_N)


def check_no_jump(seen: Seen) -> None:
    """Each plan begins at the command in force, and is followed as it is: the gate never has to clip."""
    in_force = {x.t_ns: np.array(x.command_N) for x in seen.applied if x.t_ns > 0}
    begun = [plan for plan in seen.plans if int(plan.t_ns[0]) in in_force]
    assert len(begun) > 10
    for plan in begun:
        np.testing.assert_allclose(plan.thrust_N[0], in_force[int(plan.t_ns[0])], atol=1e-6)
    assert seen.applied[-1].plans_rejected == 0
    assert seen.applied[-1].plans_late == 0
    slew = np.array([x.command_slew_N_per_s for x in seen.applied])
    assert slew.max() <= 100.0 + 1e-6


ARM, DISARM, STOP, MANUAL, RELEASE = Action.ARM, Action.DISARM, Action.STOP, Action.MANUAL, Action.RELEASE

TRANSITIONS = [
    # orders before                    then      ends as
    ({}, DISARM, "disarmed"),
    ({}, STOP, "stopped"),
    ({}, MANUAL, "manual"),
    ({3.0: MANUAL}, RELEASE, "controller"),
    ({3.0: MANUAL}, DISARM, "disarmed"),
    ({3.0: MANUAL}, STOP, "stopped"),
    ({3.0: DISARM}, ARM, "controller"),
    ({3.0: DISARM}, STOP, "stopped"),
    ({3.0: STOP}, ARM, "controller"),
]


@pytest.mark.parametrize(("before", "action", "ends"), TRANSITIONS)
def test_the_thrusters_change_hands_without_a_jump(before, action, ends):
    seen, answers = fly({**before, 4.5: action}, 8.0, stick=(40.0, -40.0, 20.0))
    assert all(x.accepted for x in answers)
    assert answers[-1].authority == authority_at(seen, 5.0) == ends
    check_no_jump(seen)
    if ends in ("disarmed", "stopped"):
        # At most a cycle, its delay, and 0.625 s from full thrust to none.
        assert not command_at(seen, 4.5 + 1.0).any()
        assert not command_at(seen, 8.0).any()
    elif ends == "manual":
        np.testing.assert_allclose(command_at(seen, 6.0), (40.0, -40.0, 20.0))
    else:
        last = seen.plans[-1]
        assert last.origin == "solved"
        assert last.reference_m is not None
        assert np.abs(last.thrust_N).max() > 1.0


def test_a_reference_message_is_followed_and_an_invalid_one_rejected_with_reason():
    there = 'kind = "point"\nnorth_m = 3.0\neast_m = -2.0\n'
    orders = {
        1.0: Command(command_id=7, action=Action.FOLLOW, reference_toml=there),
        2.0: Command(command_id=8, action=Action.FOLLOW, reference_toml=there.replace("3.0", "1e9")),
        3.0: Command(command_id=9, action=Action.FOLLOW, reference_toml="kind = "),
        3.5: Command(command_id=10, action=Action.FOLLOW, reference_toml='kind = "timed"\nfile = "/etc/passwd"\n'),
    }
    seen, answers = fly(orders, 4.0)
    accepted = {x.command_id: x.accepted for x in answers}
    assert accepted == {1: True, 7: True, 8: False, 9: False, 10: False}
    assert "north_m" in answers[2].why
    assert "1e+06" in answers[2].why or "1000000" in answers[2].why
    assert "TOML" in answers[3].why
    assert "cannot name a file" in answers[4].why
    assert seen.plans[-1].reference_m == (3.0, -2.0)
    check_no_jump(seen)


def test_hold_keeps_the_place_and_the_depth_of_the_command_and_arm_begins_anew():
    seen, answers = fly({5.0: Action.HOLD, 7.0: DISARM, 9.0: ARM}, 10.0)
    assert all(x.accepted for x in answers)
    before = next(plan for plan in seen.plans if plan.cycle_t_ns == 5_100_000_000)
    after = seen.plans[-1]
    assert before.reference_m is not None
    assert np.hypot(*np.subtract(before.reference_m, before.states[0, :2])) < 0.05
    assert np.hypot(*np.subtract(after.reference_m, before.reference_m)) > 1e-4
    assert before.reference_depth_m == after.reference_depth_m == pytest.approx(0.8, abs=0.4)
