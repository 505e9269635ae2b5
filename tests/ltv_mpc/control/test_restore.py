"""A controller that takes another's place: armed as it was, along the same path, from the plan in force."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from ltv_mpc import Controller, Estimate, Plan, PlanOrigin, Vehicle, advance, references
from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.control.node import SAVE_PERIOD_NS, ControllerNode
from ltv_mpc.messages import (
    Acknowledgement,
    Action,
    Authority,
    Command,
    ControllerState,
    CurrentProfile,
    CycleTiming,
    Health,
    Message,
    ModelCheck,
)
from ltv_mpc.node import ReceivedMessage
from ltv_mpc.safety.plan_gate import PlanGate, PlanVerdict
from ltv_mpc.validation import refusal
from tests.ltv_mpc.reports import report
from tests.stepping import step

PAPER = Vehicle.load("paper")
PERIOD_NS = 300_000_000
S = 1_000_000_000
FOLLOWED = (PlanVerdict.ACCEPTED, PlanVerdict.LATE)
START = Estimate.at_rest(north_m=0.3, heading_rad=0.4, depth_m=2.0)


class Flight:
    """A node in a closed loop of the nominal model, without delay in between."""

    def __init__(self, reference, *, node: ControllerNode | None = None, estimate: Estimate = START) -> None:
        self.node = node or ControllerNode(PAPER, reference, ControllerConfig())
        self.estimate = estimate
        self.plans: list[Plan] = []
        self.states: list[ControllerState] = []
        self.answers: list[Acknowledgement] = []
        self.words: list[Message] = []  # all
        self._sequence = 0

    def arrival(self, signal: Message) -> ReceivedMessage:
        self._sequence += 1
        return ReceivedMessage(signal, 1, self._sequence, self.estimate.t_ns)

    def step(self, *words: Message) -> Plan:
        """One cycle, and what it leads to."""
        inbox = [self.arrival(word) for word in (*words, self.estimate)]
        for signal in step(self.node, self.estimate.t_ns, inbox):
            assert refusal(signal) is None
            self.words.append(signal)
            match signal:
                case Plan():
                    self.plans.append(signal)
                case ControllerState():
                    self.states.append(signal)
                case Acknowledgement():
                    self.answers.append(signal)
        self.estimate = advance(PAPER, self.estimate, self.plans[-1], duration_s=0.3)
        return self.plans[-1]

    def fly(self, cycles: int) -> Plan:
        for _ in range(cycles):
            plan = self.step()
        return plan

    def handed_over(self, silent_s: float, reference=None) -> tuple[Flight, ControllerState]:
        """It dies; ``silent_s`` later another one has its place, the vehicle having followed the last plan."""
        last = self.plans[-1]
        estimate = self.estimate
        if silent_s > 0:
            estimate = advance(PAPER, estimate, last, duration_s=silent_s)
        state = msgspec.structs.replace(self.states[-1], plan=last, estimate=self.estimate)
        node = ControllerNode(PAPER, reference or self.node._reference, ControllerConfig())
        return Flight(None, node=node, estimate=estimate), state


ARM = Command(command_id=1, action=Action.ARM)


def armed(reference, cycles: int) -> Flight:
    flight = Flight(reference)
    flight.step(ARM)
    flight.fly(cycles)
    return flight


@pytest.mark.parametrize("silent_s", [0.0, 1.0, 4.0])
def test_it_comes_up_armed_solved_and_from_the_command_in_force(silent_s):
    before = armed(references.load("line"), 40)
    after, state = before.handed_over(silent_s)
    plan = after.step(state)
    assert (plan.authority, plan.origin, plan.health) == (Authority.CONTROLLER, PlanOrigin.SOLVED, Health.NOMINAL)
    in_force = state.plan.thrust_at(int(plan.t_ns[0]))
    np.testing.assert_allclose(plan.thrust_N[0], in_force, atol=1e-6)
    gate = PlanGate(PAPER)
    gate.offer(state.plan, 1, 0, int(state.plan.t_ns[0]))
    assert gate.offer(plan, 2, 0, int(state.plan.t_ns[0]) + S) in FOLLOWED


def test_a_path_goes_on_where_it_was_and_not_from_its_beginning():
    reference = references.load("lawnmower")
    before = armed(reference, 120)
    spared = before.plans[-1]
    after, state = before.handed_over(1.2)
    plan = after.step(state)
    before.fly(5)
    undisturbed = before.plans[-1]
    assert plan.progress == pytest.approx(undisturbed.progress, abs=0.01)
    assert plan.progress >= spared.progress > 0.01
    np.testing.assert_allclose(plan.reference_m, undisturbed.reference_m, atol=0.5)
    there = after.fly(60)
    assert there.progress > plan.progress
    assert abs(there.cross_track_m) < 0.3


def test_here_stays_where_it_was():
    before = armed(references.Hold(depth_m=5.0), 30)
    after, state = before.handed_over(1.0)
    plan = after.step(state)
    assert plan.reference_m == before.plans[-1].reference_m
    assert plan.reference_depth_m == before.plans[-1].reference_depth_m


@pytest.mark.parametrize("action", [Action.DISARM, Action.STOP, Action.MANUAL])
def test_who_was_in_charge_stays_in_charge(action):
    before = armed(references.load("line"), 5)
    before.step(Command(command_id=2, action=action))
    after, state = before.handed_over(1.0)
    plan = after.step(state)
    assert plan.authority is before.plans[-1].authority is not Authority.CONTROLLER
    assert not plan.thrust_N[-1].any()


def test_after_a_restart_the_operators_reference_is_followed_not_the_first_one():
    before = armed(references.load("line"), 3)
    text = 'kind = "point"\nnorth_m = 3.0\neast_m = -2.0\ndepth_m = 4.0\n'
    before.step(Command(command_id=2, action=Action.FOLLOW, reference_toml=text))
    before.fly(5)
    assert before.states[-1].reference_toml == text
    after, state = before.handed_over(0.6, references.load("line"))
    assert after.step(state).reference_m == (3.0, -2.0)


def test_what_was_learned_of_depth_and_delays_is_not_learned_again():
    """3 m above the depth that is wanted, on a machine whose cycles take 0.12 s at least."""
    before = armed(references.Hold(depth_m=5.0), 3)
    for k in range(40):
        ms = 120 + k % 5
        t_ns = before.estimate.t_ns - PERIOD_NS
        before.step(CycleTiming(t_ns=t_ns, compute_ns=ms * 10**6, compute_wall_ns=0, estimate_age_ns=0, stage_us={}))
    while before.states[-1].t_ns < before.plans[-1].cycle_t_ns:
        before.step()
    written = before.states[-1]
    assert abs(written.depth_integral_N) > 0.1
    assert len(written.cycle_times_ns) >= 40
    after, state = before.handed_over(0.0)
    plan = after.step(state)
    assert plan.expected_delay_ns == before.plans[-1].expected_delay_ns >= 124 * 10**6
    assert after.states[-1].depth_integral_N == before.states[-1].depth_integral_N
    forgetful, _ = before.handed_over(0.0)
    without = forgetful.step(msgspec.structs.replace(state, depth_integral_N=0.0, cycle_times_ns=()))
    assert (without.thrust_N[:, 2] != plan.thrust_N[:, 2]).any()
    quick = CycleTiming(
        t_ns=after.estimate.t_ns, compute_ns=10**6, compute_wall_ns=0, estimate_age_ns=0, stage_us={}
    )  # one that says nothing beside forty
    assert after.step(quick).expected_delay_ns >= 124 * 10**6
    assert forgetful.step(quick).expected_delay_ns < 10 * 10**6


def test_what_the_vehicle_has_been_so_far_is_handed_over_and_checked_at_the_door():
    before = armed(references.Hold(depth_m=5.0), 3)
    products = np.outer([0.5, 1.0, -1.0, 0.1], [0.5, 1.0, -1.0, 0.1])
    written = msgspec.structs.replace(before.states[-1], model_products=products)
    assert refusal(written) is None
    assert "(4, 4)" in refusal(msgspec.structs.replace(written, model_products=products[:3]))
    after, state = before.handed_over(1.0)
    after.step(msgspec.structs.replace(state, model_products=products))
    np.testing.assert_array_equal(after.states[-1].model_products, products)
    assert before.states[-1].model_products is None


def test_without_anything_to_go_on_it_begins_disarmed_as_ever():
    empty = Flight(references.load("line"))
    plan = empty.step(ControllerState(t_ns=0))
    assert (plan.authority, plan.origin) == (Authority.DISARMED, PlanOrigin.ZERO)


def test_it_writes_down_each_change_and_else_each_five_seconds():
    flight = Flight(references.load("line"))
    flight.fly(2)
    assert [c.authority for c in flight.states] == ["disarmed"]
    flight.step(ARM)
    assert flight.states[-1].authority == "controller"
    assert flight.states[-1].reference_start is not None
    count = len(flight.states)
    flight.fly(60)  # 18 s
    times = [c.t_ns for c in flight.states[count - 1 :]]
    assert len(times) == 4
    assert all(SAVE_PERIOD_NS <= gap < SAVE_PERIOD_NS + PERIOD_NS for gap in np.diff(times))
    assert flight.states[-1].progress == pytest.approx(flight.plans[-1].progress, abs=0.05)
    flight.step(Command(command_id=2, action=Action.HOLD))
    assert 'kind = "hold"' in flight.states[-1].reference_toml


def test_a_plan_of_another_horizon_is_in_force_but_no_cycle_begins_from_it():
    before = armed(references.load("line"), 40)
    _, state = before.handed_over(0.0)
    after = Controller(PAPER, references.load("line"), ControllerConfig(horizon_s=2.4))
    after.restore(state, before.estimate.t_ns)
    assert after.save(before.estimate.t_ns).plan is None
    plan = after.plan(before.estimate)
    assert plan.origin is PlanOrigin.SOLVED
    np.testing.assert_allclose(plan.thrust_N[0], state.plan.thrust_at(int(plan.t_ns[0])), atol=1e-6)


def test_two_that_were_restored_alike_give_the_same_bits():
    before = armed(references.load("square"), 30)
    one, state = before.handed_over(1.0)
    two, _ = before.handed_over(1.0)
    for flight in (one, two):
        flight.step(state)
        flight.fly(10)
    encode = msgspec.json.Encoder(enc_hook=lambda x: x.tolist()).encode
    assert encode(one.plans) == encode(two.plans)


# --- the node's own ages ---------------------------------------------------------------------------------------------


def test_estimates_out_of_order_are_not_planned_on_and_are_counted():
    flight = armed(references.load("line"), 5)
    newest = flight.estimate
    node, t = flight.node, newest.t_ns
    step(node, t, [ReceivedMessage(newest, 1, 100, t)])
    old = msgspec.structs.replace(newest, t_ns=t - S, north_m=0.0)
    for arrival in (
        ReceivedMessage(old, 1, 101, t),
        ReceivedMessage(msgspec.structs.replace(newest, t_ns=t + 1), 1, 100, t),
    ):
        plan = step(node, t + PERIOD_NS, [arrival])[0]
        assert plan.estimate_t_ns == t
    word = node.inputs()[0]
    assert (word.input, word.rejected, word.alive, word.valid) == ("estimate", 2, True, True)


def test_reports_of_a_clock_that_jumped_ahead_do_not_make_all_that_follow_look_old():
    """By 200 s, once: the model is checked again from the next report on."""
    still_water = CurrentProfile(depth_m=np.zeros(1), north_mps=np.zeros(1), east_mps=np.zeros(1))
    flight = armed(references.load("line"), 5)

    def said(ahead_ns: int) -> Message:
        return report(flight.estimate.t_ns + ahead_ns, (0.0, 0.0, 0.0))

    for ahead_ns in (0, 0, 200 * S, *[0] * 8):
        flight.estimate = msgspec.structs.replace(flight.estimate, current=still_water)
        flight.step(said(ahead_ns))
    words = [signal.t_ns for signal in flight.words if isinstance(signal, ModelCheck)]
    assert words[-1] > flight.estimate.t_ns - 2 * S
    word = flight.node.inputs()[1]
    assert (word.input, word.rejected, word.alive, word.valid) == ("applied", 1, True, True)


def test_health_follows_the_age_of_the_estimate_and_reports_that_fall_silent():
    flight = armed(references.load("line"), 12)
    node, t = flight.node, flight.estimate.t_ns - PERIOD_NS
    said = [step(node, t + k * PERIOD_NS, [])[0] for k in range(1, 12)]
    # 10 estimates at 0.3 s: 0.9, 1.5, 3 s
    assert [p.health for p in said] == ["nominal"] * 3 + ["degraded"] * 2 + ["hold"] * 5 + ["failsafe"]
    assert [p.origin for p in said] == [PlanOrigin.SOLVED] * 5 + [PlanOrigin.ZERO] * 6
