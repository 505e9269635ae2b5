"""The gate: commands against Plan.thrust_at, and against box and slew whatever is offered."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ltv_mpc.safety.gate import Gate, Verdict
from ltv_mpc.signals import Plan, PlanOrigin, Solve, SolveStatus
from ltv_mpc.vehicle.parameters import Vehicle

VEHICLE = Vehicle.load("paper")  # +-62.5 N, 100 N/s
STEP_NS = 10_000_000
STAGE_NS = 300_000_000
S = 1_000_000_000


def plan(start_ns: int, thrust: np.ndarray | list[list[float]]) -> Plan:
    thrust = np.asarray(thrust, dtype=np.float64)
    return Plan(
        cycle_t_ns=start_ns,
        t_ns=start_ns + STAGE_NS * np.arange(len(thrust)),
        thrust_N=thrust,
        states=np.zeros((len(thrust), 6)),
        origin=PlanOrigin.SOLVED,
        solve=Solve(status=SolveStatus.SOLVED),
    )


def constant(start_ns: int, *thrust: float, knots: int = 5) -> Plan:
    return plan(start_ns, [thrust] * knots)


def commands(gate: Gate, from_ns: int, until_ns: int) -> np.ndarray:
    return np.array([gate.command_at(t) for t in range(from_ns, until_ns + 1, STEP_NS)])


def test_a_plan_that_starts_at_the_command_in_force_is_followed_exactly():
    gate = Gate(VEHICLE)
    gate.command_at(0)
    followed = plan(0, [[0, 0, 0], [30, -30, 20], [60, -30, 20], [31, 0, 50]])
    assert gate.offer(followed, 1, 0, 0) is Verdict.ACCEPTED
    for t in range(0, 900_000_001, STEP_NS):
        np.testing.assert_allclose(gate.command_at(t), followed.thrust_at(t), rtol=0, atol=1e-12)


def test_the_plan_before_stays_in_force_until_the_next_one_starts():
    gate = Gate(VEHICLE)
    gate.command_at(0)
    gate.offer(plan(0, [[0, 0, 0], [30, 30, 30], [60, 60, 60]]), 1, 0, 0)
    gate.offer(plan(450_000_000, [[45, 45, 45], [45, 45, 45]]), 1, 1, 100_000_000)
    assert gate.command_at(440_000_000) == pytest.approx([44, 44, 44])
    assert gate.command_at(500_000_000) == pytest.approx([45, 45, 45])


def test_a_plan_that_waits_is_replaced_by_a_newer_one_that_starts_no_later():
    gate = Gate(VEHICLE)
    gate.command_at(0)
    gate.offer(constant(0, 5.0, 5.0, 5.0, knots=30), 1, 0, 0)
    gate.offer(constant(3 * S, 50.0, 50.0, 50.0), 1, 1, 0)
    gate.offer(constant(1 * S, 10.0, 10.0, 10.0, knots=20), 1, 2, 0)
    assert commands(gate, STEP_NS, 1 * S - STEP_NS)[-1].tolist() == [5.0, 5.0, 5.0]
    assert commands(gate, 1 * S, 2 * S)[-1].tolist() == [10.0, 10.0, 10.0]
    assert commands(gate, 2 * S, 4 * S)[-1].tolist() == [10.0, 10.0, 10.0]


def test_after_its_last_knot_the_lateral_thrusts_ramp_to_zero_and_the_vertical_one_to_the_failsafe():
    gate = Gate(VEHICLE)
    gate.command_at(0)
    gate.offer(plan(0, [[0, 0, 0], [30, -30, 30], [60, -60, 60], [62.5, -62.5, 62.5]]), 1, 0, 0)
    end = 3 * STAGE_NS
    commands(gate, 0, end)
    assert gate.command_at(end) == (62.5, -62.5, 62.5)
    assert gate.command_at(end + 100_000_000) == pytest.approx([52.5, -52.5, 52.5])
    assert gate.command_at(end + 620_000_000) == pytest.approx([0.5, -0.5, 0.5])
    assert gate.command_at(end + 630_000_000) == (0.0, 0.0, 0.0)


def test_a_late_plan_is_counted_and_met_at_the_slew_limit_at_its_present_time():
    gate = Gate(VEHICLE)
    gate.command_at(0)
    late = plan(0, [[0, 0, 0], [30, 30, 0], [60, 60, 0], [60, 60, 0], [60, 60, 0]])
    gate.command_at(400_000_000)
    assert gate.offer(late, 1, 0, 400_000_000) is Verdict.LATE
    assert gate.plans_late == 1
    rows = commands(gate, 410_000_000, 1 * S)
    np.testing.assert_allclose(np.diff(rows[:, 0])[:40], 1.0)  # 100 N/s, from 0, after a plan that stands at 40 N
    assert rows[-1, 0] == pytest.approx(60.0)
    assert rows[0, 0] == pytest.approx(1.0)


def test_a_plan_that_arrives_at_its_start_is_not_late():
    gate = Gate(VEHICLE)
    assert gate.offer(constant(S, 0.0, 0.0, 0.0), 1, 0, S) is Verdict.ACCEPTED
    assert gate.offer(constant(S, 0.0, 0.0, 0.0), 1, 1, S + 1) is Verdict.LATE


def test_plans_out_of_order_are_refused_for_each_source_by_itself():
    gate = Gate(VEHICLE)
    verdicts = [
        gate.offer(constant(0, 1.0, 1.0, 1.0), epoch, k, 0) for epoch, k in [(7, 4), (7, 4), (7, 3), (7, 5), (9, 0)]
    ]
    assert verdicts == [
        Verdict.ACCEPTED,
        Verdict.OUT_OF_ORDER,
        Verdict.OUT_OF_ORDER,
        Verdict.ACCEPTED,
        Verdict.ACCEPTED,
    ]
    assert gate.plans_refused == 2


@pytest.mark.parametrize(
    ("thrust", "verdict"),
    [
        ([[0, 0, 0], [30, 30, 30]], Verdict.ACCEPTED),
        ([[62.5 + 1e-7, 0, 0], [62.5, 0, 0]], Verdict.ACCEPTED),
        ([[62.5 + 1e-5, 0, 0], [62.5, 0, 0]], Verdict.OUTSIDE_BOX),
        ([[0, 0, 0], [0, -62.6, 0]], Verdict.OUTSIDE_BOX),
        ([[0, 0, np.nan], [0, 0, 0]], Verdict.OUTSIDE_BOX),
        ([[0, 0, 0], [30 + 1e-7, 0, 0]], Verdict.ACCEPTED),
        ([[0, 0, 0], [0, 30 + 1e-5, 0]], Verdict.OUTSIDE_SLEW),
        ([[0, 0, 0], [0, 0, -31]], Verdict.OUTSIDE_SLEW),
        ([[0, 0, 31], [0, 0, 0]], Verdict.OUTSIDE_SLEW),
    ],
)
def test_a_plan_outside_box_or_slew_is_refused_and_nothing_changes(thrust, verdict):
    gate = Gate(VEHICLE)
    gate.command_at(0)
    gate.offer(constant(0, 20.0, 20.0, 20.0, knots=20), 1, 0, 0)
    commands(gate, 0, S)
    assert gate.offer(plan(S, thrust), 1, 1, S) is verdict
    if verdict is not Verdict.ACCEPTED:
        assert gate.plans_refused == 1
        commands(gate, S, 2 * S)
        assert gate.command_at(2 * S) == (20.0, 20.0, 20.0)
        assert gate.offer(constant(2 * S, 20.0, 20.0, 20.0), 1, 1, 2 * S) is Verdict.ACCEPTED


def test_what_rounding_adds_to_a_plan_does_not_reach_the_command():
    gate = Gate(VEHICLE)
    gate.command_at(0)
    gate.offer(constant(0, 62.5 + 1e-7, -62.5 - 1e-7, 62.5), 1, 0, 0)
    assert commands(gate, 0, S)[-1].tolist() == [62.5, -62.5, 62.5]


def test_commands_do_not_go_back_in_time():
    gate = Gate(VEHICLE)
    gate.command_at(S)
    with pytest.raises(ValueError, match="before"):
        gate.command_at(S - 1)


thrusts = st.lists(st.tuples(*[st.floats(-70, 70)] * 3), min_size=2, max_size=6)
offers = st.lists(st.tuples(st.integers(-300, 600), thrusts), min_size=1, max_size=8)


@settings(max_examples=150, deadline=None)
@given(offers)
def test_no_command_leaves_box_or_slew_whatever_is_offered(sequence):
    gate = Gate(VEHICLE)
    rows = [gate.command_at(0)]
    t = 0
    for k, (ahead_ms, thrust) in enumerate(sequence):
        gate.offer(plan(t + ahead_ms * 1_000_000, thrust), 1, k, t)
        for _ in range(23):
            t += STEP_NS
            rows.append(gate.command_at(t))
    rows = np.array(rows)
    assert (np.abs(rows) <= 62.5).all()
    assert (np.abs(np.diff(rows, axis=0)) <= 1.0 + 1e-12).all()
