"""Pre-arm checks and mission policy in the controller node: what is refused, held, surfaced, and said."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from ltv_mpc import Estimate, PlanOrigin, Vehicle, references
from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.control.node import ControllerNode
from ltv_mpc.messages import (
    Acknowledgement,
    Action,
    Applied,
    Authority,
    Battery,
    ClockStep,
    Command,
    ControllerState,
    Health,
    Heartbeat,
    Leak,
    Manual,
    Message,
    MissionAction,
    Plan,
)
from ltv_mpc.safety.mission_policy import MissionSettings
from tests.ltv_mpc.control.flights import PERIOD_NS, Flight, S
from tests.ltv_mpc.reports import report

PAPER = msgspec.structs.replace(Vehicle.load("paper"), failsafe_vertical_N=-20.0)
HERE = Estimate.at_rest(north_m=0.3, heading_rad=0.4, depth_m=2.0)
ORIGIN = references.Point(north_m=0.0, east_m=0.0, depth_m=2.0)


class Craft(Flight):
    """Controller node of a craft that does not move, whose messages a test chooses."""

    def __init__(self, reference=ORIGIN, **mission) -> None:
        config = ControllerConfig(mission=MissionSettings(**mission))
        super().__init__(reference, node=ControllerNode(PAPER, reference, config), estimate=HERE)
        self.t_ns = 0

    @property
    def answer(self) -> Acknowledgement:
        return self.answers[-1]

    def step(self, *messages: Message) -> Plan | None:
        """Run a cycle on these messages, and on an estimate of now if navigation publishes."""
        self.t_ns += PERIOD_NS
        fresh = () if self.estimate is None else (msgspec.structs.replace(self.estimate, t_ns=self.t_ns),)
        return self.run(self.t_ns, *messages, *fresh)

    def fly(self, seconds: float, *messages: Message) -> Plan | None:
        """Run cycles with these messages in each."""
        for _ in range(math.ceil(seconds * S / PERIOD_NS)):
            plan = self.step(*messages)
        return plan

    def command(self, action: Action, *messages: Message, **fields) -> str:
        """Send a command; return why it was refused."""
        self.step(Command(command_id=1, action=action, **fields), *messages)
        return self.answer.why


def applied(craft: Craft, health: Health = Health.NOMINAL) -> Applied:
    """Return the report of actuators that follow the last plan."""
    t_ns = craft.t_ns + PERIOD_NS
    command_N = craft.plans[-1].thrust_at(t_ns) if craft.plans else (0.0, 0.0, 0.0)
    return msgspec.structs.replace(report(t_ns, command_N), health=health)


def armed(*reference, heard: Leak | None = None, **mission) -> Craft:
    """Return a craft that has been armed, in a cycle in which it has heard of its leak sensor."""
    craft = Craft(*reference, **mission)
    assert craft.command(Action.ARM, *(() if heard is None else (heard,))) == ""
    return craft


# --- pre-arm checks --------------------------------------------------------------------------------------------------


def test_a_craft_that_is_well_arms_and_is_told_what_is_unknown():
    craft = Craft()
    assert craft.command(Action.ARM) == ""
    assert craft.answer.warnings == (
        "warning: actuators: no report yet, so plans count as followed: check the publisher of `applied` and its link",
    )
    assert craft.step().origin is PlanOrigin.SOLVED
    craft = Craft()
    craft.step(applied(craft))
    assert craft.command(Action.ARM, applied(craft)) == ""
    assert craft.answer.warnings == ()


def refused(craft: Craft, *messages: Message, force: bool = False) -> str:
    """Return why the craft does not arm, after it has been seen to stay disarmed, or what a forced arming skips."""
    why = craft.command(Action.ARM, *messages, force=force)
    assert craft.node.arbiter.authority is (Authority.CONTROLLER if force else Authority.DISARMED)
    return "; ".join(craft.answer.warnings) if force else why


def no_estimate(craft: Craft) -> tuple[Message, ...]:
    craft.estimate = None
    return ()


def old_estimate(craft: Craft) -> tuple[Message, ...]:
    craft.step()
    craft.estimate = None
    craft.fly(0.9)
    return ()


def uncertain_estimate(craft: Craft) -> tuple[Message, ...]:
    craft.estimate = msgspec.structs.replace(HERE, covariance=np.diag([9.0, 26e2, 1, 1, 1, 1]))
    return ()


def impossible_estimate(craft: Craft) -> tuple[Message, ...]:
    craft.estimate = msgspec.structs.replace(HERE, yaw_rate_radps=50.0)
    return ()


def silent_actuators(craft: Craft) -> tuple[Message, ...]:
    craft.step(applied(craft))
    craft.fly(2.0)
    return ()


def idle_actuators(craft: Craft) -> tuple[Message, ...]:
    return (applied(craft, Health.FAILSAFE),)


def doubtful_clock(craft: Craft) -> tuple[Message, ...]:
    return (ClockStep(t_ns=craft.t_ns, input="estimate", publisher=1, step_ns=-2 * S, certain=False),)


LOW_BATTERY = Battery(voltage_V=9.0), Leak(detected=False)
LEAK = Battery(voltage_V=12.0), Leak(detected=True)


def test_a_weak_thruster_is_a_warning_that_does_not_block():
    craft = Craft()
    craft.step(ControllerState(t_ns=0, thrust_shares=(0.4, 1.0)), applied(craft))
    assert craft.command(Action.ARM, applied(craft)) == ""
    (warning,) = craft.answer.warnings
    assert warning.startswith("warning: thrusters: port ")
    assert warning.endswith(": inspect the propeller")


@pytest.mark.parametrize("force", [False, True])
@pytest.mark.parametrize(
    ("prepare", "mission", "said"),
    [
        (no_estimate, {}, "estimate: none has arrived"),
        (old_estimate, {}, "estimate: the newest is 1.2 s old: check the publisher of `estimate`"),
        (uncertain_estimate, {}, "covariance: the standard deviation of the position is 51 m, above 50 m"),
        (impossible_estimate, {}, "plan: no valid estimate: yaw rate above what the vehicle can reach"),
        (silent_actuators, {}, "actuators: the actuators do not report"),
        (idle_actuators, {}, "actuators: they do not follow the plans (health failsafe)"),
        (doubtful_clock, {}, "clock: a publisher's clock was set back, or its link is congested"),
        (LOW_BATTERY, {"battery_min_V": 10, "leak": True}, "battery: battery below 10 V: charge or replace it"),
        (LEAK, {"battery_min_V": 10, "leak": True}, "leak: leak detected"),
        ((), {"battery_min_V": 10}, "battery input: battery: no message yet"),
        ((), {"leak": True}, "leak input: leak: no message yet"),
    ],
)
def test_each_check_that_fails_is_named_with_what_to_do_and_force_skips_it(prepare, mission, said, force):
    craft = Craft(**mission)
    messages = prepare if isinstance(prepare, tuple) else prepare(craft)
    text = refused(craft, *messages, force=force)
    assert said in text
    assert ("--force" in text) == (not force)
    assert ("skipped: " in text) == force


def test_actuators_that_another_one_drives_are_a_warning_when_arming():
    craft = Craft()
    for _ in range(12):
        driven = report(craft.t_ns + PERIOD_NS, (20.0, 20.0, 0.0))
        plan = craft.step(driven)
    assert (plan.authority, plan.health) == (Authority.DISARMED, Health.DEGRADED)
    assert craft.command(Action.ARM, report(craft.t_ns + PERIOD_NS, (20.0, 20.0, 0.0))) == ""
    warning = "commands: the actuators command 20.0 / 20.0 / 0.0 N, the plan in force "
    assert any(text.startswith(f"warning: {warning}") for text in craft.answer.warnings)
    assert craft.node._model_monitor.products is None  # nothing is learned


def test_a_reference_beyond_reach_is_refused_at_its_start():
    far = references.Point(north_m=3000.0, east_m=0.0)
    assert "reference: its start is 3000 m away, more than 2000 m: check its origin" in refused(Craft(far))
    assert Craft(far, max_start_m=4000).command(Action.ARM) == ""
    line = references.load("line")
    craft = Craft(line)
    craft.estimate = msgspec.structs.replace(HERE, north_m=-5000.0)
    assert "reference: its start is" in refused(craft)


def test_a_reference_that_has_not_started_does_not_block():
    later = references.Point(north_m=0.0, east_m=0.0, start_s=1000.0)
    assert Craft(later).command(Action.ARM) == ""


def test_an_armed_controller_accepts_arm_without_checks():
    craft = Craft()
    assert craft.command(Action.ARM) == ""
    silent_actuators(craft)
    assert craft.command(Action.ARM) == ""


# --- mission policy --------------------------------------------------------------------------------------------------

ELSEWHERE = msgspec.structs.replace(HERE, north_m=7.0, east_m=-4.0, depth_m=3.0)


def test_hold_holds_the_position_and_clear_goes_on_with_the_reference():
    craft = armed(references.load("line"), operator_timeout_s=5, on_operator_loss=MissionAction.HOLD)
    assert craft.fly(4.5).progress is not None
    craft.estimate = ELSEWHERE
    plan = craft.fly(1.5)
    assert plan.authority is Authority.CONTROLLER
    assert plan.origin is PlanOrigin.SOLVED
    assert (plan.health, plan.health_why) == (Health.DEGRADED, "hold: no sign of the operator for 5 s")
    assert plan.reference_m == pytest.approx((7.0, -4.0), abs=0.01)
    assert plan.reference_depth_m == 3.0
    assert craft.node.mission.state.action is MissionAction.HOLD
    craft.step(Heartbeat())
    assert craft.command(Action.FOLLOW, reference_toml='kind = "point"\nnorth_m = 1.0\neast_m = 1.0\n') == ""
    assert craft.answer.warnings == ("hold: no sign of the operator for 5 s: `clear` ends this when its cause is gone",)
    assert craft.command(Action.CLEAR) == ""
    assert craft.step().reference_m == (1.0, 1.0)


def test_the_reference_waits_while_the_position_is_held():
    craft = armed(references.load("line"), operator_timeout_s=5, on_operator_loss=MissionAction.HOLD)
    before = craft.fly(4.8)
    craft.fly(20.0)
    assert craft.command(Action.CLEAR) == ""
    assert craft.step().reference_m == pytest.approx(before.reference_m, abs=1.0)


def test_in_a_failsafe_a_pilot_keeps_the_thrusters_until_he_is_silent_and_can_take_them_again():
    craft = armed(leak=True, heard=Leak(detected=False))
    craft.command(Action.MANUAL)
    pilot = Manual(thrust_N=(5.0, 5.0, 0.0))
    craft.step(pilot, Leak(detected=True))
    plan = craft.fly(3.0, pilot)
    assert (plan.authority, plan.health) == (Authority.MANUAL, Health.FAILSAFE)
    assert plan.thrust_N[1, 0] > 0.0
    plan = craft.fly(1.5)
    assert (plan.authority, plan.why) == (Authority.CONTROLLER, "surface: leak detected")
    craft.command(Action.MANUAL)
    assert craft.fly(2.0, pilot).authority is Authority.MANUAL


@pytest.mark.parametrize(
    "sign", [Heartbeat(), Manual(thrust_N=(0.0, 0.0, 0.0)), Command(command_id=2, action=Action.RELEASE)]
)
def test_heartbeats_commands_and_messages_of_a_pilot_are_signs_of_an_operator(sign):
    craft = armed(operator_timeout_s=2, on_operator_loss=MissionAction.SURFACE)
    assert craft.fly(10.0, sign).origin is PlanOrigin.SOLVED
    assert craft.fly(3.0).why == "surface: no sign of the operator for 2 s"


def test_after_the_mission_time_arm_is_refused_and_a_new_reference_begins_it_anew():
    craft = armed(time_limit_s=5, on_time_limit=MissionAction.SURFACE)
    assert craft.fly(6.0).why == "surface: the mission time of 5 s is over"
    craft.command(Action.DISARM)
    assert "mission time: the mission time of 5 s is over: send `follow` for a new mission" in refused(craft)
    assert craft.command(Action.FOLLOW, reference_toml='kind = "hold"') == ""
    assert craft.command(Action.ARM) == ""
    assert craft.step().origin is PlanOrigin.SOLVED


def test_a_restarted_controller_keeps_holding_and_its_mission_time():
    settings = {"operator_timeout_s": 5, "on_operator_loss": MissionAction.HOLD, "time_limit_s": 100}
    before = Craft(references.load("line"), **settings)
    before.command(Action.ARM)
    before.fly(6.0)
    after = Craft(references.load("line"), **settings)
    after.t_ns = before.t_ns
    after.estimate = ELSEWHERE
    after.step(before.states[-1])
    plan = after.step()
    assert plan.health_why == "hold: no sign of the operator for 5 s"
    assert plan.reference_m == pytest.approx((7.0, -4.0), abs=0.01)
    assert after.node.mission.state.start_t_ns == before.node.mission.state.start_t_ns
    after.step(Heartbeat())
    assert after.command(Action.CLEAR) == ""
    assert after.step().progress is not None
