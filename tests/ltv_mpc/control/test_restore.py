"""Restart of the controller: same authority, same progress along the path, from the plan in force."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from ltv_mpc import Controller, Plan, PlanOrigin, Vehicle, references
from ltv_mpc.control.config import ControllerConfig, Disturbance
from ltv_mpc.control.controller import SAVE_PERIOD_NS
from ltv_mpc.messages import (
    Acknowledgement,
    Action,
    Authority,
    Command,
    ControllerState,
    CycleTiming,
    DisturbanceState,
    Health,
)
from ltv_mpc.safety.plan_gate import PlanGate, PlanVerdict
from ltv_mpc.validation import rejection_reason
from tests.ltv_mpc.control.flights import ARM, PERIOD_NS, Flight, S, armed

PAPER = Vehicle.load("paper")
LEARNED = DisturbanceState(
    mean=np.array([0.12, -0.16, 0.1, 0.0, *np.linspace(-0.1, 0.1, 8)]), covariance=1e-4 * (np.eye(12) + 0.1)
)
FOLLOWED = (PlanVerdict.ACCEPTED, PlanVerdict.LATE)


@pytest.mark.parametrize("silent_s", [0.0, 1.0, 4.0])
def test_it_restarts_armed_and_solves_from_the_command_in_force(silent_s):
    before = armed(references.load("line"), 40)
    after, state = before.handed_over(silent_s)
    plan = after.step(state)
    assert (plan.authority, plan.origin, plan.health) == (Authority.CONTROLLER, PlanOrigin.SOLVED, Health.NOMINAL)
    in_force = state.plan.thrust_at(int(plan.t_ns[0]))
    np.testing.assert_allclose(plan.thrust_N[0], in_force, atol=1e-6)
    gate = PlanGate(PAPER)
    gate.offer(state.plan, 1, 0, int(state.plan.t_ns[0]))
    assert gate.offer(plan, 2, 0, int(state.plan.t_ns[0]) + S) in FOLLOWED


def test_a_path_continues_from_the_saved_progress():
    reference = references.load("lawnmower")
    before = armed(reference, 60)
    last = before.plans[-1]
    after, state = before.handed_over(1.2)
    plan = after.step(state)
    before.fly(5)
    undisturbed = before.plans[-1]
    assert plan.progress == pytest.approx(undisturbed.progress, abs=0.01)
    assert plan.progress >= last.progress > 0.01
    np.testing.assert_allclose(plan.reference_m, undisturbed.reference_m, atol=0.5)
    there = after.fly(30)
    assert there.progress > plan.progress
    assert abs(there.cross_track_m) < 0.3


def test_a_hold_keeps_its_position():
    before = armed(references.Hold(depth_m=5.0), 30)
    after, state = before.handed_over(1.0)
    plan = after.step(state)
    assert plan.reference_m == before.plans[-1].reference_m
    assert plan.reference_depth_m == before.plans[-1].reference_depth_m


@pytest.mark.parametrize("action", [Action.DISARM, Action.STOP, Action.MANUAL])
def test_the_authority_is_restored(action):
    before = armed(references.load("line"), 5)
    before.step(Command(command_id=2, action=action))
    after, state = before.handed_over(1.0)
    plan = after.step(state)
    assert plan.authority is before.plans[-1].authority is not Authority.CONTROLLER
    assert not plan.thrust_N[-1].any()


def test_an_operator_s_reference_is_restored():
    before = armed(references.load("line"), 3)
    text = 'kind = "point"\nnorth_m = 3.0\neast_m = -2.0\ndepth_m = 4.0\n'
    before.step(Command(command_id=2, action=Action.FOLLOW, reference_toml=text))
    before.fly(5)
    assert before.states[-1].reference_toml == text
    after, state = before.handed_over(0.6, references.load("line"))
    assert after.step(state).reference_m == (3.0, -2.0)


def test_depth_integral_and_delays_are_restored():
    """The vehicle is 3 m above the reference depth, and a cycle takes at least 0.12 s."""
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
    reset, _ = before.handed_over(0.0)
    without = reset.step(msgspec.structs.replace(state, depth_integral_N=0.0, cycle_times_ns=()))
    assert (without.thrust_N[:, 2] != plan.thrust_N[:, 2]).any()
    quick = CycleTiming(
        t_ns=after.estimate.t_ns, compute_ns=10**6, compute_wall_ns=0, estimate_age_ns=0, stage_us={}
    )  # changes nothing beside forty others
    assert after.step(quick).expected_delay_ns >= 124 * 10**6
    assert reset.step(quick).expected_delay_ns < 10 * 10**6


def test_the_model_monitor_s_products_are_restored_and_validated():
    before = armed(references.Hold(depth_m=5.0), 3)
    products = np.outer([0.5, 1.0, -1.0, 0.1, 0.0, 0.0], [0.5, 1.0, -1.0, 0.1, 0.0, 0.0])
    written = msgspec.structs.replace(before.states[-1], model_products=products)
    assert rejection_reason(written) is None
    assert "(6, 6)" in rejection_reason(msgspec.structs.replace(written, model_products=products[:3]))
    after, state = before.handed_over(1.0)
    after.step(msgspec.structs.replace(state, model_products=products))
    np.testing.assert_array_equal(after.states[-1].model_products, products)
    assert before.states[-1].model_products is None


def test_the_target_waits_once_the_vehicle_has_come_to_the_end_of_its_plan():
    """A long time later it is where the last plan has ended, at most 5 s after the one in the state."""
    before = armed(references.load("lawnmower"), 60)
    state = before.node.controller.save(before.estimate.t_ns)
    ends_s = before.node.controller.config.reach_s + 5.0

    def progress(silent_s):
        after = Controller(PAPER, references.load("lawnmower"), ControllerConfig())
        after.restore(state, before.estimate.t_ns + round(silent_s * S))
        return after.save(before.estimate.t_ns).schedule_s

    assert progress(1.0) < progress(4.0) < progress(9.0) < progress(ends_s + 0.9) == progress(600.0)
    assert state.schedule_s < progress(600.0) <= state.schedule_s + ends_s + 0.4


def test_the_learned_current_is_restored_and_less_certain_after_a_while():
    before = armed(references.Hold(depth_m=5.0), 3)
    states = {}
    for silent_s in (0.0, 100.0):
        state = msgspec.structs.replace(before.states[-1], disturbance=LEARNED)
        assert rejection_reason(state) is None
        after = Controller(PAPER, references.load("line"), ControllerConfig())
        after.restore(state, state.t_ns + round(silent_s * S))
        states[silent_s] = after.save(0).disturbance
    np.testing.assert_array_equal(states[0.0].mean, LEARNED.mean)
    np.testing.assert_array_equal(states[0.0].covariance, LEARNED.covariance)
    np.testing.assert_array_equal(states[100.0].mean, LEARNED.mean)
    walked = np.diag(states[100.0].covariance - LEARNED.covariance)
    assert walked[:4] == pytest.approx([9e-4, 9e-4, 1e-4, 1e-4])  # 3 mm/s and 1 mm per sqrt(s), over 100 s
    assert walked[4:] == pytest.approx([1e-2] * 7 + [walked[-1]])  # 1 % per sqrt(s)
    assert walked[-1] > 0.0
    never = ControllerConfig(disturbance=Disturbance(sd_mps=0.0))
    without = Controller(PAPER, references.load("line"), never)
    without.restore(state, state.t_ns)
    assert not without.save(0).disturbance.mean[:2].any()


@pytest.mark.parametrize(
    ("mean", "covariance", "why"),
    [
        (LEARNED.mean[:4], LEARNED.covariance, "must be (12)"),
        (LEARNED.mean, LEARNED.covariance[:4], "must be (12, 12)"),
        (LEARNED.mean, -LEARNED.covariance, "must not be negative"),
        (LEARNED.mean, LEARNED.covariance + 1e-4 * np.eye(12, k=1), "symmetric"),
        (LEARNED.mean, 1e-4 * (2.0 - np.eye(12)), "positive semidefinite"),
    ],
)
def test_what_no_observer_can_have_learned_is_rejected(mean, covariance, why):
    learned = DisturbanceState(mean=mean, covariance=covariance)
    assert why in rejection_reason(ControllerState(t_ns=0, disturbance=learned))


@pytest.mark.parametrize("disarmed_by", [None, Action.DISARM, Action.STOP])
def test_only_a_restart_lets_the_next_arm_continue_the_reference(disarmed_by):
    """It may even be restarted twice, as long as no operator has disarmed the vehicle."""
    before = armed(references.load("lawnmower"), 60)
    after, state = before.handed_over(1.2)
    plan = after.step(msgspec.structs.replace(state, authority=Authority.DISARMED, arm_continues=True))
    assert plan.authority is Authority.DISARMED
    assert after.states[-1].arm_continues
    if disarmed_by is not None:
        after.step(Command(command_id=2, action=disarmed_by))
        assert not after.states[-1].arm_continues
    again, state = after.handed_over(0.0, references.load("lawnmower"))
    again.step(state)
    plan = again.step(ARM)
    assert plan.authority is Authority.CONTROLLER
    assert (plan.progress >= before.plans[-1].progress > 0.01) == (disarmed_by is None)
    assert not again.states[-1].arm_continues


def test_the_state_is_published_before_the_acknowledgement_and_after_the_plan():
    flight = armed(references.load("line"), 3)
    flight.step(Command(command_id=2, action=Action.STOP))
    kinds = [type(message) for message in flight.messages]
    assert kinds[-3:] == [Plan, ControllerState, Acknowledgement]
    assert flight.states[-1].authority is flight.answers[-1].authority is Authority.STOPPED


def test_from_an_empty_state_it_begins_disarmed():
    empty = Flight(references.load("line"))
    plan = empty.step(ControllerState(t_ns=0))
    assert (plan.authority, plan.origin) == (Authority.DISARMED, PlanOrigin.ZERO)


def test_the_state_is_published_at_each_change_and_every_five_seconds():
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


def test_a_plan_of_another_horizon_is_in_force_but_not_shifted():
    before = armed(references.load("line"), 40)
    _, state = before.handed_over(0.0)
    after = Controller(PAPER, references.load("line"), ControllerConfig(horizon_s=2.4))
    after.restore(state, before.estimate.t_ns)
    assert after.save(before.estimate.t_ns).plan is None
    plan = after.plan(before.estimate)
    assert plan.origin is PlanOrigin.SOLVED
    np.testing.assert_allclose(plan.thrust_N[0], state.plan.thrust_at(int(plan.t_ns[0])), atol=1e-6)
