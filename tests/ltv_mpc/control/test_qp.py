"""The QP and its solution, held against the equations it stands for, other solvers, and a Riccati recursion."""

from __future__ import annotations

import numpy as np
import pytest

from ltv_mpc import build_qp, solve_qp
from ltv_mpc.control.cost import cost
from ltv_mpc.control.linearisation import roll_out, velocity_over_ground
from ltv_mpc.control.problem_data import unpack_objective
from ltv_mpc.control.qp.problem import QP, residuals
from ltv_mpc.control.qp.sparse import STAGE_VARIABLES
from ltv_mpc.vehicle.parameters import Vehicle
from tests.ltv_mpc.control.problems import LIMITS, precise

PAPER = Vehicle.load("paper")
P = PAPER.coefficients()


def test_the_constraints_are_the_dynamics_box_and_slew_of_the_trajectory(cycles):
    """A point that obeys the LTV model obeys the equalities; the other rows are its commands and their changes."""
    rng = np.random.default_rng(0)
    cycle = cycles[40]
    lin, form = cycle.lin, cycle.form
    N = form.stages
    qp = form.build(lin, cycle.target)
    U = lin.U + np.vstack([np.zeros(2), rng.normal(size=(N, 2)) * 5])
    X = [lin.X[0]]
    for k in range(N):
        step = lin.Phi[k] + lin.A[k] @ (X[k] - lin.X[k])
        X.append(step + lin.B0[k] @ (U[k] - lin.U[k]) + lin.B1[k] @ (U[k + 1] - lin.U[k + 1]))
    X = np.array(X)
    scale = np.concatenate([LIMITS.state_scale, [62.5, 62.5]])
    z = np.concatenate([(X[1:] - lin.X[1:]) / scale, (U[1:] - lin.U[1:]) / 62.5], axis=1)
    velocity, slope = velocity_over_ground(lin.X[-1], lin.C[-1])
    end = velocity + slope @ (X[-1] - lin.X[-1])[2:5]
    rows = qp.A @ np.concatenate([z.ravel(), end])
    equal = N * 8 + 2
    np.testing.assert_allclose(rows[:equal], qp.l[:equal], atol=1e-9)
    np.testing.assert_array_equal(qp.l[:equal], qp.u[:equal])
    # slew rows: change of U against +-30 N; box rows: U against +-62.5 N
    slew, box = slice(equal, equal + 2 * N), slice(equal + 2 * N, None)
    change = np.diff(U, axis=0).ravel() / 62.5
    np.testing.assert_allclose(qp.u[slew] - rows[slew], 30 / 62.5 - change, atol=1e-12)
    np.testing.assert_allclose(rows[slew] - qp.l[slew], 30 / 62.5 + change, atol=1e-12)
    np.testing.assert_allclose(qp.u[box] - rows[box], 1 - U[1:].ravel() / 62.5, atol=1e-12)
    np.testing.assert_allclose(rows[box] - qp.l[box], 1 + U[1:].ravel() / 62.5, atol=1e-12)


def test_the_objective_is_the_documented_cost(cycles):
    """1/2 z'Pz + q'z differs from half the cost of the trajectory by a constant."""
    rng = np.random.default_rng(0)
    cycle = cycles[40]
    lin, form = cycle.lin, cycle.form
    N = form.stages
    qp = form.build(lin, cycle.target)
    scale = np.concatenate([LIMITS.state_scale, [62.5, 62.5]])
    velocity, _ = velocity_over_ground(lin.X[-1], lin.C[-1])

    def both(z, end):
        X, U = lin.X.copy(), lin.U.copy()
        X[1:] += z[:, :8] * scale
        U[1:] += z[:, 8:] * 62.5
        p, w = X[1:, :2] - cycle.target[:-1, :2], form.weights
        u = U / 62.5
        direct = (
            w.position_per_m2 * (p**2).sum()
            + w.terminal_position_per_m2 * (p[-1] ** 2).sum()
            + w.terminal_velocity_s2_per_m2 * (end**2).sum()
            + w.thrust * (u[1:] ** 2).sum()
            + w.thrust_change * (np.diff(u, axis=0) ** 2).sum()
        )
        x = np.concatenate([z.ravel(), end])
        return 0.5 * x @ (qp.P @ x) + qp.q @ x, 0.5 * direct

    q0, d0 = both(np.zeros((N, STAGE_VARIABLES)), np.zeros(2))
    for _ in range(5):
        q1, d1 = both(rng.normal(size=(N, STAGE_VARIABLES)), rng.normal(size=2))
        assert q1 - q0 == pytest.approx(d1 - d0, rel=1e-9)
    # and the cost that the line search compares is the same one
    assert cost(lin.X, lin.U, lin.C, cycle.target, unpack_objective(form.packed)) == pytest.approx(
        2 * (d0 + 0.5 * form.weights.terminal_velocity_s2_per_m2 * (velocity**2).sum()), rel=1e-12
    )


def without_limits(form, qp):
    equal = form.stages * 8 + 2
    low, high = qp.l.copy(), qp.u.copy()
    low[equal:], high[equal:] = -1e9, 1e9
    return QP(qp.P, qp.q, qp.A, low, high)


def riccati(cycle):
    """Optimal dU (N, 2) without limits by dynamic programming over z = [dX, dU_k, 1], input dU_(k+1)."""
    lin, form = cycle.lin, cycle.form
    N, w, F = form.stages, form.weights, 62.5
    velocity, slope = velocity_over_ground(lin.X[-1], lin.C[-1])

    def stage_cost(k):
        """Cost over [dX_k, dU_k, 1] and the link to dU_(k-1), as a matrix over [dX_k, dU_k, dU_(k-1), 1]."""
        H = np.zeros((13, 13))
        for i in range(2):
            row = np.zeros(13)
            row[i], row[12] = 1.0, lin.X[k, i] - cycle.target[k - 1, i]
            weight = w.position_per_m2 + (w.terminal_position_per_m2 if k == N else 0.0)
            H += weight * np.outer(row, row)
            row = np.zeros(13)
            row[8 + i], row[12] = 1 / F, lin.U[k, i] / F
            H += w.thrust * np.outer(row, row)
            row = np.zeros(13)
            row[8 + i], row[10 + i], row[12] = 1 / F, -1 / F, (lin.U[k, i] - lin.U[k - 1, i]) / F
            H += w.thrust_change * np.outer(row, row)
            if k == N:
                row = np.zeros(13)
                row[2:5], row[12] = slope[i], velocity[i]
                H += w.terminal_velocity_s2_per_m2 * np.outer(row, row)
        return H

    value = np.zeros((11, 11))  # over [dX_k, dU_k, 1]
    gains = []
    for k in range(N, 0, -1):
        # [dX_k, dU_k, dU_(k-1), 1] from z = [dX_(k-1), dU_(k-1), 1] and v = dU_k
        step = np.zeros((13, 13))  # columns: z (11), v (2)
        step[:8, :8], step[:8, 8:10] = lin.A[k - 1], lin.B0[k - 1]
        step[:8, 10] = lin.Phi[k - 1] - lin.X[k]
        step[:8, 11:13] = lin.B1[k - 1]
        step[8:10, 11:13] = np.eye(2)
        step[10:12, 8:10] = np.eye(2)
        step[12, 10] = 1.0
        onward = step[[*range(10), 12]]
        M = step.T @ stage_cost(k) @ step + onward.T @ value @ onward
        K = -np.linalg.solve(M[11:, 11:], M[11:, :11])
        value = M[:11, :11] + M[:11, 11:] @ K
        gains.append(K)
    z = np.concatenate([np.zeros(10), [1.0]])
    out = []
    for k, K in enumerate(reversed(gains)):
        v = K @ z
        dX = lin.A[k] @ z[:8] + lin.B0[k] @ z[8:10] + lin.B1[k] @ v + lin.Phi[k] - lin.X[k + 1]
        z = np.concatenate([dX, v, [1.0]])
        out.append(v)
    return np.array(out)


def test_the_unconstrained_problem_agrees_with_a_time_varying_riccati_recursion(cycles):
    for cycle in cycles[10::40]:
        qp = without_limits(cycle.form, cycle.form.build(cycle.lin, cycle.target))
        ours = cycle.form.commands(cycle.lin, precise(qp))[1:] - cycle.lin.U[1:]
        want = riccati(cycle)
        np.testing.assert_allclose(ours, want, rtol=0, atol=1e-6 * max(1.0, np.abs(want).max()))


@pytest.mark.parametrize("solver", ["daqp", "osqp"])
def test_build_and_solve_are_public_for_any_trajectory(solver):
    N = 17
    U = np.zeros((N + 1, 2))
    C = np.zeros((N + 1, 2))
    X = roll_out(np.array([1.0, 0, 0.1, 0, 0, 0, 0, 0]), U, C, np.full(N, 0.3), P)
    qp = build_qp(PAPER, X, U, C, np.zeros((N, 2)))
    solution = solve_qp(qp, solver)
    kkt = residuals(qp, solution.x, solution.y)
    assert max(kkt.stationarity, kkt.primal, kkt.complementarity) < 1e-5
