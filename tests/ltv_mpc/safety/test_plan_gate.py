"""Plan gate: commands against Plan.thrust_at, and within box and slew limit for every sequence of plans."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ltv_mpc.bounded import MOST
from ltv_mpc.messages import Plan
from ltv_mpc.safety.plan_gate import PlanGate, PlanVerdict
from ltv_mpc.vehicle.parameters import Vehicle
from tests.ltv_mpc.plans import plan_of as plan

VEHICLE = Vehicle.load("paper")  # +-62.5 N, 100 N/s
STEP_NS = 10_000_000
STAGE_NS = 300_000_000
S = 1_000_000_000


@pytest.fixture
def gate() -> PlanGate:
    """Return a gate whose thrusters are at rest at the time 0."""
    made = PlanGate(VEHICLE)
    made.command_at(0)
    return made


def constant(start_ns: int, *thrust: float, knots: int = 5) -> Plan:
    return plan(start_ns, [thrust] * knots)


def commands(gate: PlanGate, from_ns: int, until_ns: int) -> np.ndarray:
    return np.array([gate.command_at(t) for t in range(from_ns, until_ns + 1, STEP_NS)])


def test_a_plan_that_starts_at_the_command_in_force_is_followed_exactly(gate):
    followed = plan(0, [[0, 0, 0], [30, -30, 20], [60, -30, 20], [31, 0, 50]])
    assert gate.offer(followed, 1, 0, 0) is PlanVerdict.ACCEPTED
    for t in range(0, 900_000_001, STEP_NS):
        np.testing.assert_allclose(gate.command_at(t), followed.thrust_at(t), rtol=0, atol=1e-12)
    with pytest.raises(ValueError, match="is before"):
        gate.command_at(0)


def test_the_plan_before_stays_in_force_until_the_next_one_starts(gate):
    gate.offer(plan(0, [[0, 0, 0], [30, 30, 30], [60, 60, 60]]), 1, 0, 0)
    gate.offer(plan(450_000_000, [[45, 45, 45], [45, 45, 45]]), 1, 1, 100_000_000)
    assert gate.command_at(440_000_000) == pytest.approx([44, 44, 44])
    assert gate.command_at(500_000_000) == pytest.approx([45, 45, 45])


def test_a_future_plan_is_replaced_by_a_newer_one_that_starts_no_later(gate):
    gate.offer(constant(0, 5.0, 5.0, 5.0, knots=30), 1, 0, 0)
    gate.offer(constant(3 * S, 50.0, 50.0, 50.0), 1, 1, 0)
    gate.offer(constant(1 * S, 10.0, 10.0, 10.0, knots=20), 1, 2, 0)
    assert commands(gate, STEP_NS, 1 * S - STEP_NS)[-1].tolist() == [5.0, 5.0, 5.0]
    first, *_, last = commands(gate, 1 * S, 2 * S).tolist()
    assert (first, last) == ([6.0] * 3, [10.0] * 3)
    assert commands(gate, 2 * S, 4 * S)[-1].tolist() == [10.0, 10.0, 10.0]


def test_a_late_plan_is_counted_and_approached_at_the_slew_limit(gate):
    late = plan(0, [[0, 0, 0], [30, 30, 0], [60, 60, 0], [60, 60, 0], [60, 60, 0]])
    gate.command_at(400_000_000)
    assert gate.offer(late, 1, 0, 400_000_000) is PlanVerdict.LATE
    assert gate.plans_late == 1
    rows = commands(gate, 410_000_000, 1 * S)
    np.testing.assert_allclose(np.diff(rows[:, 0])[:40], 1.0)  # 100 N/s, from 0, after a plan that stands at 40 N
    assert rows[-1, 0] == pytest.approx(60.0)
    assert rows[0, 0] == pytest.approx(1.0)


def test_a_plan_that_arrives_at_its_start_is_not_late(gate):
    assert gate.offer(constant(S, 0.0, 0.0, 0.0), 1, 0, S) is PlanVerdict.ACCEPTED
    assert gate.offer(constant(S, 0.0, 0.0, 0.0), 1, 1, S + 1) is PlanVerdict.LATE


def test_a_plan_that_has_ended_does_not_replace_the_one_in_force(gate):
    gate.offer(constant(0, 0.0, 0.0, 30.0, knots=50), 1, 0, 0)
    ended = constant(3 * S, 9.0, 9.0, 9.0, knots=5)  # until 4.2 s
    assert gate.offer(ended, 1, 1, round(4.2 * S)) is PlanVerdict.LATE
    gate.offer(constant(4 * S, 0.0, 0.0, 30.0, knots=50), 1, 2, 5 * S)
    assert gate.offer(ended, 1, 3, round(4.2 * S) + 1) is PlanVerdict.ENDED
    assert gate.command_at(8 * S) == (0.0, 0.0, 30.0)
    assert gate.plans_rejected == 1


def test_plans_out_of_order_are_rejected(gate):
    verdicts = [gate.offer(constant(0, 1.0, 1.0, 1.0), 7, k, 0) for k in (4, 4, 3, 5)]
    assert verdicts == [PlanVerdict.ACCEPTED, PlanVerdict.OUT_OF_ORDER, PlanVerdict.OUT_OF_ORDER, PlanVerdict.ACCEPTED]
    assert gate.plans_rejected == 2


# --- how long a plan is followed -------------------------------------------------------------------------------------

LONG = 47
"""Knots of a plan that reaches 13.8 s ahead."""


@pytest.mark.parametrize(
    ("timeout_s", "period_s", "end_s"), [(5.0, 0.3, 5.0), (1.5, 0.3, 1.5), (5.0, 4.0, 10.0), (20.0, 0.3, 13.8)]
)
def test_without_a_new_plan_the_thrusters_go_to_rest_however_long_the_plan_is(timeout_s, period_s, end_s):
    vehicle = msgspec.structs.replace(VEHICLE, plan_timeout_s=timeout_s, failsafe_vertical_N=-20.0)
    gate = PlanGate(vehicle)
    last = commanded(gate, 7, 3 * round(period_s * 1e9), period_ns=round(period_s * 1e9), thrust=50.0, knots=LONG)
    end = last + round(end_s * 1e9)
    assert (commands(gate, last + 3 * S // 2, end) == 50.0).all()
    assert gate.health(end) != "failsafe"
    assert gate.health(end + 1) == "failsafe"
    np.testing.assert_allclose(gate.command_at(end + S // 10), [40.0, 40.0, 40.0])
    assert gate.command_at(end + S) == (0.0, 0.0, -20.0)


def test_the_period_of_a_former_commander_does_not_lengthen_a_plan(gate):
    last = commanded(gate, 7, 20 * S, period_ns=4 * S, thrust=50.0, knots=LONG)
    begin = last + 11 * S
    gate.command_at(begin)
    assert gate.offer(constant(begin, 0.0, 0.0, 0.0, knots=LONG), 9, 0, begin) is PlanVerdict.ACCEPTED
    assert gate.health(begin + 5 * S) == "degraded"
    assert gate.health(begin + 5 * S + 1) == "failsafe"


# --- one commander at a time -----------------------------------------------------------------------------------------


def commanded(
    gate: PlanGate, epoch: int, until_ns: int, *, period_ns: int = STAGE_NS, thrust: float = 10.0, knots: int = 18
) -> int:
    """Send a plan each period up to ``until_ns`` and return the time of the last one."""
    for k, t in enumerate(range(0, until_ns, period_ns)):
        gate.command_at(t)
        assert gate.offer(constant(t, thrust, thrust, thrust, knots=knots), epoch, k, t) is PlanVerdict.ACCEPTED
    return t


def test_two_commanders_do_not_alternate_and_the_seconds_plans_are_rejected(gate):
    for k in range(20):
        t = k * STAGE_NS
        gate.offer(constant(t, 5.0, 5.0, 5.0, knots=18), 7, k, t)
        commands(gate, t, t + 100_000_000)
        at = t + 110_000_000
        assert gate.offer(constant(at, -5.0, -5.0, -5.0, knots=18), 9, k, at) is PlanVerdict.SECOND_COMMANDER
        assert gate.plans_rejected == k + 1
    assert gate.command_at(6 * S) == (5.0, 5.0, 5.0)


@pytest.mark.parametrize(("period_s", "silence_s"), [(0.1, 0.5), (0.3, 0.75), (0.71, 1.775)])
def test_a_commander_is_replaced_once_two_replacements_of_its_plan_are_missing(period_s, silence_s, gate):
    period_ns, silence_ns = round(period_s * 1e9), round(silence_s * 1e9)
    last = commanded(gate, 7, 5 * S, period_ns=period_ns)
    assert gate.health(last + silence_ns) == "nominal"
    early = constant(last + silence_ns, 20.0, 20.0, 20.0)
    assert gate.offer(early, 9, 0, last + silence_ns) is PlanVerdict.SECOND_COMMANDER
    assert gate.health(last + silence_ns + 1) == "degraded"
    late = constant(last + silence_ns + 1, 20.0, 20.0, 20.0)
    assert gate.offer(late, 9, 1, last + silence_ns + 1) is PlanVerdict.ACCEPTED
    # The one before, that was only delayed, is now the second.
    assert gate.offer(constant(last + S, 0.0, 0.0, 0.0), 7, 999, last + silence_ns + 2) is PlanVerdict.SECOND_COMMANDER
    assert gate.plans_rejected == 2


def test_after_the_end_of_its_plan_a_commander_is_replaced_at_once(gate):
    gate.offer(constant(0, 1.0, 1.0, 1.0, knots=2), 7, 0, 0)
    assert gate.health(STAGE_NS) == "nominal"
    assert gate.health(STAGE_NS + 1) == "failsafe"
    assert gate.offer(constant(STAGE_NS + 1, 1.0, 1.0, 1.0), 9, 0, STAGE_NS + 1) is PlanVerdict.ACCEPTED


def test_a_commander_whose_plans_are_rejected_is_replaced(gate):
    last = commanded(gate, 7, 3 * S)
    for k in range(8):
        gate.offer(constant(last + k * 100_000_000, 99.0, 0.0, 0.0), 7, 100 + k, last + k * 100_000_000)
    at = last + 800_000_000
    assert gate.offer(constant(at, 10.0, 10.0, 10.0), 9, 0, at) is PlanVerdict.ACCEPTED


def test_old_frames_of_a_commander_that_was_replaced_are_never_followed_again(gate):
    last = commanded(gate, 7, 3 * S)
    gate.offer(constant(last + S, 1.0, 1.0, 1.0), 9, 0, last + S)
    assert gate.offer(constant(last + 9 * S, 1.0, 1.0, 1.0), 7, 3, last + 9 * S) is PlanVerdict.OUT_OF_ORDER


@pytest.mark.parametrize(
    ("thrust", "verdict"),
    [
        ([[0, 0, 0], [30, 30, 30]], PlanVerdict.ACCEPTED),
        ([[62.5 + 1e-7, 0, 0], [62.5, 0, 0]], PlanVerdict.ACCEPTED),
        ([[62.5 + 1e-5, 0, 0], [62.5, 0, 0]], PlanVerdict.OUTSIDE_BOX),
        ([[0, 0, 0], [0, -62.6, 0]], PlanVerdict.OUTSIDE_BOX),
        ([[0, 0, np.nan], [0, 0, 0]], PlanVerdict.OUTSIDE_BOX),
        ([[0, 0, 0], [30 + 1e-7, 0, 0]], PlanVerdict.ACCEPTED),
        ([[0, 0, 0], [0, 30 + 1e-5, 0]], PlanVerdict.OUTSIDE_SLEW),
        ([[0, 0, 0], [0, 0, -31]], PlanVerdict.OUTSIDE_SLEW),
        ([[0, 0, 31], [0, 0, 0]], PlanVerdict.OUTSIDE_SLEW),
    ],
)
def test_a_plan_outside_box_or_slew_is_rejected_and_nothing_changes(thrust, verdict, gate):
    gate.offer(constant(0, 20.0, 20.0, 20.0, knots=20), 1, 0, 0)
    commands(gate, 0, S)
    assert gate.offer(plan(S, thrust), 1, 1, S) is verdict
    if verdict is not PlanVerdict.ACCEPTED:
        assert gate.plans_rejected == 1
        commands(gate, S, 2 * S)
        assert gate.command_at(2 * S) == (20.0, 20.0, 20.0)
        assert gate.offer(constant(2 * S, 20.0, 20.0, 20.0), 1, 1, 2 * S) is PlanVerdict.ACCEPTED


def test_the_memory_of_commanders_is_bounded(gate):
    for epoch in range(1000):
        at = epoch * 10 * S
        assert gate.offer(constant(at, 0.0, 0.0, 0.0), epoch, 5, at) is PlanVerdict.ACCEPTED
    assert len(gate._last_sequence) == MOST


def test_what_rounding_adds_to_a_plan_does_not_reach_the_command(gate):
    gate.offer(constant(0, 62.5 + 1e-7, -62.5 - 1e-7, 62.5), 1, 0, 0)
    assert commands(gate, 0, S)[-1].tolist() == [62.5, -62.5, 62.5]


thrusts = st.lists(st.tuples(*[st.floats(-70, 70)] * 3), min_size=2, max_size=6)
offers = st.lists(st.tuples(st.integers(-300, 600), thrusts, st.integers(0, 2)), min_size=1, max_size=8)


@given(offers)
def test_no_command_leaves_box_or_slew_limit_for_any_sequence_of_plans(sequence):
    gate = PlanGate(VEHICLE)
    rows = [gate.command_at(0)]
    t = 0
    for k, (ahead_ms, thrust, epoch) in enumerate(sequence):
        gate.offer(plan(t + ahead_ms * 1_000_000, thrust), epoch, k, t)
        for _ in range(23):
            t += STEP_NS
            rows.append(gate.command_at(t))
    rows = np.array(rows)
    assert (np.abs(rows) <= 62.5).all()
    assert (np.abs(np.diff(rows, axis=0)) <= 1.0 + 1e-12).all()


def test_before_the_first_plan_has_started_no_thruster_turns():
    """The vehicle may still be on deck, so the failsafe thrust has to wait for a controller."""
    gate = PlanGate(msgspec.structs.replace(VEHICLE, failsafe_vertical_N=-20.0))
    assert not commands(gate, 0, S).any()
    assert gate.offer(constant(2 * S, 0.0, 0.0, 30.0, knots=2), 1, 0, S) is PlanVerdict.ACCEPTED
    assert not commands(gate, S + STEP_NS, 2 * S - STEP_NS).any()
    assert commands(gate, 2 * S, 2 * S + 200_000_000)[-1][2] == pytest.approx(21.0)
