"""Every number of the QP against its documented terms, written out anew for three stages that resemble no motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ltv_mpc import Vehicle, build_qp
from ltv_mpc.control.config import Weights
from ltv_mpc.control.horizon_limits import MIN_PENALTY, HorizonLimits
from ltv_mpc.control.linearisation import Linearisation
from ltv_mpc.control.qp.sparse import NO_BOUND, SparseQp

N = 3
KNOTS = np.array([0.0, 1.0, 2.0, 3.7])
LENGTH = np.diff(KNOTS)
FULL_N = np.array([62.5, 50.0])
SCALE = np.array([1.5, 1.5, 0.4, 0.4, 1.0, 0.2, *FULL_N])
LIMITS = HorizonLimits(np.array([-40.0, -50.0]), np.array([62.5, 30.0]), np.array([30.0, 20.0]), SCALE[:6])
WEIGHTS = Weights(
    position_per_m2=1.3,
    terminal_position_per_m2=7.0,
    terminal_velocity_s2_per_m2=11.0,
    thrust=0.17,
    thrust_change=0.05,
    heading_per_rad2=0.4,
)
FORM = SparseQp(KNOTS, LIMITS, WEIGHTS)


@pytest.fixture
def lin():
    """Return a trajectory with gaps between its stages; sensitivities without structure but for the documented one."""
    rng = np.random.default_rng(5)
    X = rng.normal(size=(N + 1, 8)) * SCALE
    A, B0, B1 = (rng.normal(size=(N, 8, k)) for k in (8, 2, 2))
    A[:, :, :2] = A[:, 6:, :] = 0.0
    A[:, range(8), range(8)] = rng.uniform(0.5, 1.0, (N, 8))
    for B in (B0, B1):
        B[:, 6, 1] = B[:, 7, 0] = 0.0
    U = rng.uniform(-20, 20, (N + 1, 2))
    return Linearisation.from_arrays(X, U, rng.normal(size=(N + 1, 2)), X[1:] + rng.normal(size=(N, 8)), A, B0, B1)


@pytest.fixture
def target():
    """Positions, velocity and headings; some of these are more than half a turn away."""
    return np.random.default_rng(6).normal(size=(N + 1, 3)) * 3


def unpacked(lin, z):
    """States and commands that a point of the QP stands for, and the error of the terminal velocity that it carries."""
    X, U = lin.X.copy(), lin.U.copy()
    for k in range(N):
        X[k + 1] += z[10 * k : 10 * k + 8] * SCALE
        U[k + 1] += z[10 * k + 8 : 10 * k + 10] * FULL_N
    return X, U, z[-2:]


def terms(lin, target, z):
    """Square roots of the cost's terms."""
    X, U, end = unpacked(lin, z)
    for k in range(1, N + 1):
        g = LENGTH[k - 1]
        yield np.sqrt(1.3 * g) * (X[k, :2] - target[k - 1, :2])
        turn = np.remainder(lin.X[k, 4] - target[k - 1, 2] + np.pi, 2.0 * np.pi) - np.pi  # of the nominal heading
        yield np.sqrt(0.4 * g) * (turn + X[k, 4:5] - lin.X[k, 4])
        yield np.sqrt(0.17 * g) * U[k] / FULL_N
        yield np.sqrt(0.05 / g) * (U[k] - U[k - 1]) / FULL_N
    yield np.sqrt(7.0) * (X[N, :2] - target[N - 1, :2])
    yield np.sqrt(11.0) * end


def model_errors(lin, target, z):
    """Return the residual of each equality: model minus state at a stage's end, then the terminal velocity's error."""
    X, U, end = unpacked(lin, z)
    for k in range(N):
        predicted = lin.Phi[k] + lin.A[k] @ (X[k] - lin.X[k])
        predicted += lin.B0[k] @ (U[k] - lin.U[k]) + lin.B1[k] @ (U[k + 1] - lin.U[k + 1])
        yield (predicted - X[k + 1]) / SCALE

    def over_ground(x):
        v = (x[2] + 1j * x[3]) * np.exp(1j * x[4]) + lin.C[N, 0] + 1j * lin.C[N, 1]
        return np.array([v.real, v.imag])

    h = 1e-6
    turned = [(over_ground(lin.X[N] + h * e) - over_ground(lin.X[N] - h * e)) / (2 * h) for e in np.eye(8)]
    yield over_ground(lin.X[N]) + (X[N] - lin.X[N]) @ turned - target[N, :2] - end


def affine(function):
    """Matrix and constant of an affine function of a point of the QP."""
    constant = np.concatenate(list(function(np.zeros(10 * N + 2))))
    return np.array([np.concatenate(list(function(e))) - constant for e in np.eye(10 * N + 2)]).T, constant


def test_the_cost_is_the_sum_of_squares_that_is_documented(lin, target):
    """Up to a constant, and to the factor 1/2 that a QP has."""
    qp = FORM.build(lin, target)
    slope, constant = affine(lambda z: terms(lin, target, z))
    np.testing.assert_allclose(qp.P.toarray(), slope.T @ slope, atol=1e-12)
    np.testing.assert_allclose(qp.q, slope.T @ constant, atol=1e-12)


def test_equalities_are_the_errors_of_the_model(lin, target):
    qp, m = FORM.build(lin, target), 8 * N + 2
    slope, constant = affine(lambda z: model_errors(lin, target, z))
    np.testing.assert_allclose(qp.A.toarray()[:m], slope, atol=1e-9)
    np.testing.assert_allclose(qp.l[:m], -constant, atol=1e-9)
    np.testing.assert_array_equal(qp.l[:m], qp.u[:m])


def test_inequalities_are_the_distances_of_commands_from_slew_and_box(lin, target):
    qp, z = FORM.build(lin, target), np.random.default_rng(7).normal(size=10 * N + 2)
    _, U, _ = unpacked(lin, z)
    rows = qp.A @ z
    slew, box = slice(8 * N + 2, 10 * N + 2), slice(10 * N + 2, 12 * N + 2)
    change = np.diff(U, axis=0)
    np.testing.assert_allclose((qp.u - rows)[slew].reshape(N, 2) * FULL_N, np.outer(LENGTH, [30.0, 20.0]) - change)
    np.testing.assert_allclose((rows - qp.l)[slew].reshape(N, 2) * FULL_N, change + np.outer(LENGTH, [30.0, 20.0]))
    np.testing.assert_allclose((qp.u - rows)[box].reshape(N, 2) * FULL_N, [62.5, 30.0] - U[1:])
    np.testing.assert_allclose((rows - qp.l)[box].reshape(N, 2) * FULL_N, U[1:] - [-40.0, -50.0])


def test_box_rows_lead_a_start_outside_the_box_into_it_at_the_slew_limit(lin, target):
    """From 150 N and -100 N, by 30 N and 20 N per first stage."""
    lin.U[0] = 150.0, -100.0
    qp, box = FORM.build(lin, target), slice(10 * N + 2, 12 * N + 2)
    low, high = (bound[box].reshape(N, 2) * FULL_N + lin.U[1:] for bound in (qp.l, qp.u))
    np.testing.assert_allclose(high.T, [[120.0, 90.0, 62.5], [30.0, 30.0, 30.0]])
    np.testing.assert_allclose(low.T, [[-40.0, -40.0, -40.0], [-80.0, -60.0, -50.0]])


def test_rows_of_motion_limits_are_distances_beyond_which_an_excess_costs(lin, target):
    limited, bounds = [2, 5], np.array([[-0.1, -0.15], [0.3, 0.2]])
    form = SparseQp(KNOTS, replace(LIMITS, state_bounds=bounds), WEIGHTS)
    qp, z = form.build(lin, target), np.random.default_rng(9).normal(size=form.variables)
    X, _, _ = unpacked(lin, z)
    state, limits, excess = X[1:, limited] / SCALE[limited], bounds / SCALE[limited], z[10 * N + 2 :].reshape(N, 2)
    rows, low, high = (x[12 * N + 2 :].reshape(N, 2, 3) for x in (qp.A @ z, qp.l, qp.u))
    np.testing.assert_allclose((high - rows)[:, :, 0], limits[1] - state + excess)
    np.testing.assert_allclose(
        (rows - low)[:, :, 1:], np.stack([state - limits[0] + excess, excess], axis=2), atol=1e-12
    )
    np.testing.assert_array_equal(low[:, :, 0], -NO_BOUND)
    np.testing.assert_array_equal(high[:, :, 1:], NO_BOUND)
    far = np.hypot(*(target[:-1, :2] - lin.X[0, :2]).T)
    pull = WEIGHTS.position_per_m2 * LENGTH @ far + WEIGHTS.terminal_position_per_m2 * far[-1]
    penalty = max(MIN_PENALTY, pull * SCALE[0])
    np.testing.assert_allclose(qp.q[10 * N + 2 :].reshape(N, 2), np.outer(penalty * LENGTH, [1.0, 1.0]))


ONE_SIDED = np.array([[-0.1, -0.15], [0.3, np.inf]])


@pytest.mark.parametrize("limits", [LIMITS, replace(LIMITS, state_bounds=ONE_SIDED)], ids=["box", "motion"])
def test_every_row_of_every_stage_has_a_name(limits):
    form = SparseQp(KNOTS, limits, WEIGHTS)
    names = [row.name for row in form.row_names]
    assert len(names) == len(set(names)) == form.rows
    for stage in range(1, N + 1):
        assert f"slew of port in stage {stage}" in names


def test_a_trajectory_on_its_reference_has_no_slope_of_the_position_cost(lin):
    vehicle, wanted = Vehicle.load("paper"), (0.3, -0.2)
    qp = build_qp(vehicle, lin.X, lin.U, lin.C, lin.X[1:, :2])
    np.testing.assert_array_equal(qp.q[: 10 * N].reshape(N, 10)[:, :2], 0.0)
    moving = build_qp(vehicle, lin.X, lin.U, lin.C, lin.X[1:, :2], end_velocity_mps=wanted)
    np.testing.assert_allclose((moving.l - qp.l)[8 * N : 8 * N + 2], wanted)


def test_the_pattern_does_not_depend_on_the_numbers(lin, target):
    """A number that happens to be zero keeps its place; nothing stands where the documented model has none."""
    still = Linearisation.from_arrays(*lin[:4], 0 * lin.A, 0 * lin.B0, 0 * lin.B1)
    moving, zero = FORM.build(lin, target).A, FORM.build(still, target).A
    np.testing.assert_array_equal(moving.indices, zero.indices)
    np.testing.assert_array_equal(moving.indptr, zero.indptr)
    assert (moving.data != 0).all()


def test_commands_are_those_that_a_point_stands_for(lin):
    z = np.random.default_rng(8).normal(size=10 * N + 2)
    np.testing.assert_allclose(FORM.commands(lin, z), unpacked(lin, z)[1])


def test_the_layout_follows_the_number_of_half_planes(lin, target):
    form = SparseQp(KNOTS, LIMITS, WEIGHTS)
    rows = np.zeros((N, 2, 4))
    rows[:, 0] = [0.6, 0.8, -0.1, 5.0]
    rows[:, 1] = [1.0, 0.0, -0.2, 7.0]
    fenced = Linearisation.from_arrays(*lin[:-2], rows)
    before = form.build(lin, target)
    qp = form.build(fenced, target)
    assert qp.A.shape == (before.A.shape[0] + 4 * N, before.A.shape[1] + 2 * N)
    assert len(form.row_names) == form.rows == len(qp.l)
    assert len(qp.q) == len(qp.P.toarray()) == form.variables
    bounds, costs = qp.l[-4 * N :: 2].reshape(N, 2), qp.q[-2 * N :].reshape(N, 2)
    np.testing.assert_array_equal(bounds, rows[:, :, 2])
    np.testing.assert_array_equal(costs, rows[:, :, 3])
    after = form.build(lin, target)
    np.testing.assert_array_equal(after.A.toarray(), before.A.toarray())
    assert len(form.row_names) == form.rows == len(after.l)
    assert not form.match(lin)
    assert form.match(fenced)


def test_one_stage_is_a_horizon_too(lin, target):
    one = SparseQp(KNOTS[:2], LIMITS, WEIGHTS)
    short = Linearisation.from_arrays(
        lin.X[:2], lin.U[:2], lin.C[:2], *(x[:1] for x in (lin.Phi, lin.A, lin.B0, lin.B1))
    )
    qp = one.build(short, target[:2])
    assert qp.A.shape == (14, 12)
    whole = FORM.build(lin, target)
    np.testing.assert_array_equal(qp.A.toarray()[:8, :10], whole.A.toarray()[:8, :10])
