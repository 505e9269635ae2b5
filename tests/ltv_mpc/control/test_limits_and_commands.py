"""Box and slew of everything that is sent, also where two plans meet; the commands in force by time."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from ltv_mpc import Vehicle
from ltv_mpc.control.config import Weights
from ltv_mpc.control.ocp.limits import clip_to_limits
from ltv_mpc.control.prediction import SentCommands
from ltv_mpc.control.problem_data import Constants
from ltv_mpc.messages import Array
from ltv_mpc.safety.plan_gate import PlanGate, PlanVerdict
from tests.ltv_mpc.plans import plan_of as plan

PAPER = Vehicle.load("paper")
LIMITS = Constants.of(PAPER, Weights(), np.arange(2.0))
SECOND = 1_000_000_000


def clipped(commands: Array) -> Array:
    out = commands.copy()
    clip_to_limits(out, np.arange(float(len(out))), LIMITS.low, LIMITS.high, LIMITS.max_change)
    return out


@given(arrays(np.float64, (6, 2), elements=st.floats(-500, 500)), arrays(np.float64, 2, elements=st.floats(-80, 80)))
def test_enforced_commands_obey_slew_exactly_and_the_box_as_soon_as_they_can(commands, start):
    commands[0] = start
    out = clipped(commands)
    np.testing.assert_array_equal(out[0], start)
    assert (np.abs(np.diff(out, axis=0)) <= 30.0 + 1e-9).all()
    for k in range(1, 6):
        low = np.minimum(-62.5, start + 30.0 * k)
        high = np.maximum(62.5, start - 30.0 * k)
        assert (out[k] >= low - 1e-9).all()
        assert (out[k] <= high + 1e-9).all()


@given(arrays(np.float64, (6, 2), elements=st.floats(-12, 12)))
def test_commands_inside_the_limits_are_left_alone(commands):
    np.testing.assert_array_equal(clipped(commands), commands)


def test_every_thruster_has_its_own_limits_and_is_scaled_by_its_larger_side():
    own = {"port": {"min_N": -20.0, "max_N": 50.0, "slew_N_per_s": 40.0}, "starboard": {"min_N": -60.0, "max_N": 30.0}}
    thruster = msgspec.to_builtins(PAPER.thruster)
    changed = {name: values | own.get(name, {}) for name, values in thruster.items()}
    vehicle = msgspec.convert(msgspec.to_builtins(PAPER) | {"thruster": changed}, Vehicle)
    limits = Constants.of(vehicle, Weights(), LIMITS.t)
    np.testing.assert_array_equal(limits.low, [-20.0, -60.0])
    np.testing.assert_array_equal(limits.high, [50.0, 30.0])
    np.testing.assert_allclose(limits.max_change, [12.0, 30.0])
    np.testing.assert_array_equal(limits.thrust_scale, [50.0, 60.0])


def test_commands_beyond_box_or_slew_become_the_nearest_allowed_ones():
    """The expected values are worked out by hand: at most 30 N from the knot before, then the box."""
    wanted = np.array([[0.0, 0.0], [100.0, -10.0], [100.0, -50.0], [100.0, -200.0], [-100.0, 0.0]])
    allowed = [[0.0, 0.0], [30.0, -10.0], [60.0, -40.0], [62.5, -62.5], [32.5, -32.5]]
    np.testing.assert_allclose(clipped(wanted), allowed)


def test_a_plan_is_in_force_from_its_first_knot_and_the_next_takes_over_at_its_own():
    sent = SentCommands(PAPER)
    sent.add(plan(0, [[0, 0, 0], [30, -30, 10], [60, -60, 20]]))
    sent.add(plan(150_000_000, [[15, -15, 5], [0, 0, 0], [0, 0, 0]]))
    at = sent.at(np.array([75_000_000, 150_000_000, 300_000_000, 450_000_000]))
    np.testing.assert_allclose(at[:, 0], [7.5, 15.0, 7.5, 0.0], atol=1e-6)
    np.testing.assert_allclose(at[:, 1], [-7.5, -15.0, -7.5, 0.0], atol=1e-6)


def test_after_the_last_knot_every_thruster_ramps_to_rest_at_its_own_slew_limit():
    vehicle = msgspec.structs.replace(PAPER, failsafe_vertical_N=-10.0)
    sent = SentCommands(vehicle)
    sent.add(plan(0, [[0, 0, 0], [20, -10, 30]]))
    end = 300_000_000
    at = sent.at(np.array([end, end + 100_000_000, end + 200_000_000, end + 400_000_000, end + 2 * SECOND]))
    np.testing.assert_allclose(at[:, 0], [20, 10, 0, 0, 0], atol=1e-6)
    np.testing.assert_allclose(at[:, 1], [-10, 0, 0, 0, 0], atol=1e-6)
    np.testing.assert_allclose(at[:, 2], [30, 20, 10, -10, -10], atol=1e-6)


@given(
    plan_timeout_s=st.floats(0.5, 6.0),
    period_s=st.sampled_from([0.3, 0.7, 2.1]),
    cycles=st.integers(2, 4),
    seed=st.integers(0, 2**32 - 1),
)
def test_the_commands_in_force_are_those_of_the_actuators_when_plans_stop(plan_timeout_s, period_s, cycles, seed):
    """Plans of 6 s come at their start, and then none: the gate goes to rest, and the controller predicts it."""
    vehicle = msgspec.structs.replace(PAPER, plan_timeout_s=plan_timeout_s, failsafe_vertical_N=-10.0)
    period_ns = round(period_s * SECOND)
    gate, sent = PlanGate(vehicle), SentCommands(vehicle, period_ns)
    gate.command_at(0)
    change = np.random.default_rng(seed).uniform(-30.0, 30.0, (21, 3))
    for k in range(cycles):
        start = k * period_ns
        change[0] = gate.command_at(start)
        one = plan(start, np.clip(np.cumsum(change, axis=0), -62.5, 62.5))
        sent.add(one)
        assert gate.offer(one, 1, k, start) is PlanVerdict.ACCEPTED
    times = np.arange(start, start + 10 * SECOND, 10_000_000)
    # The gate notices an end within one of its steps, in which the command changes by 1 N at most.
    np.testing.assert_allclose(sent.at(times), [gate.command_at(t) for t in times.tolist()], atol=2.0)


def test_two_thrusters_that_come_to_rest_together_have_one_knot():
    """The times differ by a rounding error; a prediction over a stage of no length would not be finite."""
    sent = SentCommands(PAPER)
    sent.add(plan(0, [[0, 0, 0], [62.5, np.nextafter(62.5, 0.0), 30.0]]))
    t, thrust = sent.knots
    np.testing.assert_array_equal(t, [-1, 0, 300_000_000, 600_000_000, 925_000_000])  # at rest before it
    np.testing.assert_allclose(thrust[-1], 0.0, atol=1e-6)


def test_from_a_reported_command_the_plan_is_approached_at_the_slew_limit():
    """A plan came late, or the controller has just started: the next plan begins at the command in force."""
    sent = SentCommands(PAPER)
    sent.add(plan(0, np.full((10, 3), 40.0)))
    sent.correct(1_000_000_000, (10.0, 40.0, 62.5))
    at = sent.at(np.array([1_000_000_000, 1_200_000_000, 1_300_000_000, 2_000_000_000]))
    np.testing.assert_allclose(at[:, 0], [10.0, 30.0, 40.0, 40.0], atol=0.02)
    np.testing.assert_allclose(at[:, 1], 40.0, atol=0.02)
    np.testing.assert_allclose(at[:, 2], [62.5, 42.5, 40.0, 40.0], atol=0.02)


@pytest.mark.parametrize("thruster", range(3))
def test_one_thruster_with_another_command_is_a_difference(thruster):
    """Each thruster by itself, between knots; a rounding error is no difference."""
    sent = SentCommands(PAPER)
    sent.add(plan(0, [[0, 0, 0], [30, -30, 10], [60, -60, 20], [10, 40, -20]]))
    before = [part.copy() for part in sent.knots]
    now = sent.at(np.array([750_000_000]))[0]
    sent.correct(750_000_000, tuple(now + 0.005))
    np.testing.assert_array_equal(sent.knots[1], before[1])
    now[thruster] += 1.0
    sent.correct(750_000_000, tuple(now))
    np.testing.assert_allclose(sent.at(np.array([750_000_000]))[0], now)


def test_without_a_plan_a_reported_command_ramps_to_rest():
    sent = SentCommands(PAPER)
    sent.correct(0, (50.0, -50.0, 20.0))
    at = sent.at(np.array([0, 250_000_000, 500_000_000, SECOND]))
    np.testing.assert_allclose(at[:, 0], [50.0, 25.0, 0.0, 0.0], atol=0.02)
    np.testing.assert_allclose(at[:, 1], [-50.0, -25.0, 0.0, 0.0], atol=0.02)
