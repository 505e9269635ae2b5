"""Optimality of a solution along the stages: the Karush-Kuhn-Tucker (KKT) conditions, without a sparse matrix.

For the commands dU and the duals y of the limits (order of rows as in ``riccati.py``), a forward sweep of the dynamics
gives the states dX, and an adjoint sweep gives the duals of the dynamics:

    lambda_k   = gradient of the cost of knot k in dX_k + a' y of its soft rows + A_k' lambda_(k+1),   lambda_(N+1) = 0
    stationary:  gradient of the cost in U_k + duals of box and slew + B1_(k-1)' lambda_k + B0_k' lambda_(k+1) = 0
    a row      :  g = the point of [low, high] nearest to g + y,   if |y| < cap
                  g beyond its bound on the side of y,             if |y| = cap

The error is the largest violation of both, in units of the scaled QP; of a row, the smaller one of its two conditions.
It takes as long as a fifth of a Riccati sweep.
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.control.linearisation import Linearisation, multiply_A, multiply_A_transposed, velocity_over_ground
from ltv_mpc.control.problem_data import Objective, heading_slope, stage_length
from ltv_mpc.control.qp.riccati import HARD_ROWS, NORMAL, SweepWorkspace
from ltv_mpc.jit import copy_to, jit_outlined
from ltv_mpc.messages import Array
from ltv_mpc.vehicle.flow import STATES


@jit_outlined
def optimality_error(
    lin: Linearisation, target: Array, o: Objective, work: SweepWorkspace, y: Array, dU: Array
) -> float:
    """Return the largest violation of the KKT conditions; infinite if a number is not finite.

    Parameters
    ----------
    lin : the motion along the nominal trajectory.
    target : (N+1, 3) as in ``Solver.build``.
    o : weights, limits and scales.
    work : bounds of the rows, and their values g at the solution.
    y : (N, R) duals of the rows.
    dU : (N+1, 2) deviations of the commands from the nominal ones (N).
    """
    N, worst, total = dU.shape[0] - 1, 0.0, 0.0
    dX = np.zeros((N + 1, STATES))
    for k in range(N):
        multiply_A(lin.A, k, dX[k], dX[k + 1])
        for i in range(STATES):
            for j in range(2):
                dX[k + 1, i] += lin.B0[k, i, j] * dU[k, j] + lin.B1[k, i, j] * dU[k + 1, j]
            dX[k + 1, i] += lin.Phi[k, i] - lin.X[k + 1, i]
    velocity, V = velocity_over_ground(lin.X[N], lin.C[N])
    costate, before = np.zeros(STATES), np.zeros(STATES)
    for i in range(2):
        w = velocity[i] - target[N, i]
        for j in range(3):
            w += V[i, j] * dX[N, 2 + j]
        costate[i] = o.terminal_position * (lin.X[N, i] + dX[N, i] - target[N - 1, i])
        for j in range(3):
            costate[2 + j] += o.terminal_velocity * V[i, j] * w
    from_next = np.zeros(2)  # what the stage after knot k + 1 adds to the gradient in its command, times F
    for k in range(N - 1, -1, -1):
        g = stage_length(o, k + 1)
        for i in range(2):
            costate[i] += o.position * g * (lin.X[k + 1, i] + dX[k + 1, i] - target[k, i])
        costate[4] += heading_slope(lin.X, target, k + 1, o) + o.heading * g * dX[k + 1, 4]
        for m in range(work.normal.shape[1]):
            for i in range(NORMAL):
                costate[i] += work.normal[k, m, i] * y[k, HARD_ROWS + m]
        for i in range(2):
            F = o.thrust_scale[i]
            here, last = (lin.U[k + 1, i] + dU[k + 1, i]) / F, (lin.U[k, i] + dU[k, i]) / F
            change = o.thrust_change / g * (here - last) + y[k, 2 + i]
            gradient = o.thrust * g * here + y[k, i] + change + from_next[i]
            from_next[i] = -change
            for j in range(STATES):
                gradient += F * lin.B1[k, j, i] * costate[j]
                from_next[i] += F * lin.B0[k, j, i] * costate[j]
            worst = max(worst, abs(gradient))
            total += gradient
        multiply_A_transposed(lin.A, k, costate, before)
        copy_to(costate, before)
    for k in range(N):
        for i in range(y.shape[1]):
            value, dual, cap = work.g[k, i], y[k, i], work.cap[k, i]
            inside = work.high[k, i] - value if dual > 0.0 else value - work.low[k, i]
            error = max(inside, abs(abs(dual) - cap))  # as an exceeded row
            if abs(dual) < cap:
                nearest = min(max(value + dual, work.low[k, i]), work.high[k, i])
                error = min(error, abs(value - nearest))
            worst = max(worst, error)
            total += value + dual
    return worst if np.isfinite(total) else np.inf
