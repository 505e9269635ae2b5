"""Rows of box, slew and motion along a trajectory that resembles no motion, written out anew."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from ltv_mpc import Vehicle
from ltv_mpc.control.config import Weights
from ltv_mpc.control.linearisation import Linearisation
from ltv_mpc.control.ocp.limits import MIN_PENALTY, ROWS, clip_to_limits
from ltv_mpc.control.ocp.problem import roll_out, row_values
from ltv_mpc.control.problem_data import Constants
from ltv_mpc.messages import Array
from tests.ltv_mpc.control.problems import LIMITS as OF_PAPER
from tests.ltv_mpc.control.problems import PAPER, Form

N = 3
KNOTS = np.array([0.0, 1.0, 2.0, 3.7])
LENGTH = np.diff(KNOTS)
FULL_N = np.array([62.5, 50.0])
SCALE = np.array([1.5, 1.5, 0.4, 0.4, 1.0, 0.2, *FULL_N, *FULL_N, *FULL_N])
LIMITS = OF_PAPER._replace(
    low=np.array([-40.0, -50.0]),
    high=np.array([62.5, 30.0]),
    max_change=np.array([30.0, 20.0]),
    thrust_scale=FULL_N,
    state_scale=SCALE[:6],
)
BOUNDS = np.array([[-0.1, -0.15], [0.3, 0.2]])
WEIGHTS = Weights(position_per_m2=1.3, terminal_position_per_m2=7.0)
FORM = Form(KNOTS, LIMITS._replace(low_state=BOUNDS[0], high_state=BOUNDS[1]), WEIGHTS)


@pytest.fixture
def lin() -> Linearisation:
    """Return a trajectory with gaps between its stages; sensitivities without structure but for the documented one."""
    rng = np.random.default_rng(5)
    X = rng.normal(size=(N + 1, 8)) * SCALE[:8]
    A, B0, B1 = (rng.normal(size=(N, 8, k)) for k in (8, 2, 2))
    U = rng.uniform(-20, 20, (N + 1, 2))
    return Linearisation(X, U, rng.normal(size=(N + 1, 2)), X[1:] + rng.normal(size=(N, 8)), A, B0, B1)


@pytest.fixture
def target() -> Array:
    return np.random.default_rng(6).normal(size=(N + 1, 3)) * 3


def test_rows_are_distances_of_commands_and_states_from_their_bounds(lin, target) -> None:
    p, z = FORM.problem(lin, target), np.random.default_rng(7).normal(size=(N + 1, 12))
    z[-1, 10:] = 0.0
    roll_out(p, z)
    X, U = lin.X + z[:, :8] * SCALE[:8], lin.U + z[:, 8:10] * FULL_N
    dX, dU = np.zeros((N + 1, 8)), U - lin.U
    for k in range(N):
        dX[k + 1] = lin.A[k] @ dX[k] + lin.B0[k] @ dU[k] + lin.B1[k] @ dU[k + 1] + lin.Phi[k] - lin.X[k + 1]
    np.testing.assert_allclose(X - lin.X, dX, atol=1e-9)  # the dynamics of the problem are those of the motion
    np.testing.assert_allclose(np.diff(U - lin.U, axis=0), z[:-1, 10:] * FULL_N)
    g = np.empty(p.low.shape)
    row_values(p, z, g)
    above, below = p.high - g, g - p.low
    np.testing.assert_allclose(above[1:, :2] * FULL_N, [62.5, 30.0] - U[1:])
    np.testing.assert_allclose(below[1:, :2] * FULL_N, U[1:] - [-40.0, -50.0])
    change, largest = np.diff(U, axis=0), np.outer(LENGTH, [30.0, 20.0])
    np.testing.assert_allclose(above[:-1, 2:4] * FULL_N, largest - change)
    np.testing.assert_allclose(below[:-1, 2:4] * FULL_N, largest + change)
    for row, state in ((4, 2), (5, 5)):
        np.testing.assert_allclose(above[1:, row] * SCALE[state], BOUNDS[1, row - 4] - X[1:, state])
        np.testing.assert_allclose(below[1:, row] * SCALE[state], X[1:, state] - BOUNDS[0, row - 4])
    assert np.isinf(p.penalty[:, :4]).all()
    assert p.low.shape[1] == ROWS
    far = np.hypot(*(target[:-1, :2] - lin.X[0, :2]).T)
    pull = WEIGHTS.position_per_m2 * LENGTH @ far + WEIGHTS.terminal_position_per_m2 * far[-1]
    penalty = max(MIN_PENALTY, pull * SCALE[0])
    np.testing.assert_allclose(p.penalty[1:, 4:], np.outer(penalty * LENGTH, [1.0, 1.0]))


def test_nothing_is_bounded_where_nothing_can_be_changed_or_no_limit_is_set(lin, target) -> None:
    p = Form(KNOTS, LIMITS, WEIGHTS).problem(lin, target)
    for bound in (p.low, p.high):
        assert np.isinf(bound[0, :2]).all()  # the command in force
        assert np.isinf(bound[-1, 2:4]).all()  # no stage follows
        assert np.isinf(bound[:, 4:]).all()
    assert not p.G[:, 4:].any()


def test_a_start_outside_the_box_is_led_into_it_at_the_slew_limit(lin, target) -> None:
    """From 150 N and -100 N, by 30 N and 20 N per first stage."""
    lin.U[0] = 150.0, -100.0
    p = FORM.problem(lin, target)
    low, high = (bound[1:, :2] * FULL_N + lin.U[1:] for bound in (p.low, p.high))
    np.testing.assert_allclose(high.T, [[120.0, 90.0, 62.5], [30.0, 30.0, 30.0]])
    np.testing.assert_allclose(low.T, [[-40.0, -40.0, -40.0], [-80.0, -60.0, -50.0]])


# --- commands that are sent are inside the limits ---


def clipped(commands: Array) -> Array:
    out = commands.copy()
    clip_to_limits(out, np.arange(float(len(out))), OF_PAPER.low, OF_PAPER.high, OF_PAPER.max_change)
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
    limits = Constants.of(vehicle, Weights(), OF_PAPER.t)
    np.testing.assert_array_equal(limits.low, [-20.0, -60.0])
    np.testing.assert_array_equal(limits.high, [50.0, 30.0])
    np.testing.assert_allclose(limits.max_change, [12.0, 30.0])
    np.testing.assert_array_equal(limits.thrust_scale, [50.0, 60.0])


def test_commands_beyond_box_or_slew_become_the_nearest_allowed_ones():
    """The expected values are worked out by hand: at most 30 N from the knot before, then the box."""
    wanted = np.array([[0.0, 0.0], [100.0, -10.0], [100.0, -50.0], [100.0, -200.0], [-100.0, 0.0]])
    allowed = [[0.0, 0.0], [30.0, -10.0], [60.0, -40.0], [62.5, -62.5], [32.5, -32.5]]
    np.testing.assert_allclose(clipped(wanted), allowed)
