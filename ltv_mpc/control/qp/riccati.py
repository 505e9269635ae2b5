"""Riccati recursion on the QP: it solves the problem exactly where no inequality is left.

    minimise   the QP's cost (``sparse.py``)  +  sum over k = 1..N, i of   1/2 w g^2 + l g
    subject to the dynamics,   g_k = [z_k, z_k - z_(k-1), a_1' dX_k, .. a_M' dX_k],   z_k = dU_k / F (2,)

g are the rows of a stage's limits: box of port, of starboard, slew of port, of starboard, then M soft limits of the
state with their normals a: limits of the motion, then half-planes of the fence. A method that treats limits
(solvers/riccati_solver.py) turns them into the quadratic terms ``weight`` w and the linear terms ``linear`` l, both
(N, R) with R = 4 + M.

The state of the recursion at knot k is s = [dX_k, dU_k] (10,), and its input is mu = dU_(k+1):

    s_(k+1) = [A_k dX_k + B0_k dU_k + B1_k mu + gap_k,  mu],      gap_k = Phi_k - Xbar_(k+1)
    V_k(s)  = cost of knot k + min over mu of  cost of the change + V_(k+1)(s_(k+1)) = 1/2 s' P s + p' s

A backward sweep gives P, p and the feedback law mu = K s + kappa, a forward sweep the commands. Both together take
about 2000 products a stage, as long as two or three iterations of OSQP (Rao, Wright & Rawlings 1998).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ltv_mpc.control.horizon_limits import LIMITED_STATES, NO_BOUND, command_bounds
from ltv_mpc.control.linearisation import Linearisation, velocity_over_ground
from ltv_mpc.control.problem_data import (
    Objective,
    excess_penalty,
    heading_slope,
    is_limited,
    limited_state_count,
    stage_length,
)
from ltv_mpc.jit import jit, jit_outlined
from ltv_mpc.messages import Array

HARD_ROWS = 4
"""Rows of box and slew; they are the first of a stage."""

NORMAL = 6
"""Size of a soft row's normal: n, e, u, v, psi, r."""

DIM = 10
"""Size of s = [u, v, psi, r, F1, F2, U1, U2, n, e]. As many numbers determine s_(k+1), except that n and e are
integrated: [u, v, psi, r, F1, F2, U1, U2, mu1, mu2].
"""
STRIDE = 12
"""Length of a row in memory: whole vector registers."""
D, P, W, Q = 0, STRIDE * DIM, 2 * STRIDE * DIM, 3 * STRIDE * DIM
"""Offsets in the scratch array: D = ds_(k+1); P; P D; D' P D. It is one array, and most offsets in it are written out,
for the reason given in vehicle/sensitivity.py: this is four times as fast.
"""
P_GAP, SLOPE, K = 4 * STRIDE * DIM, 4 * STRIDE * DIM + STRIDE, 4 * STRIDE * DIM + 2 * STRIDE
"""Offsets of p + P gap, of D' (p + P gap), and of both rows of K."""
SCRATCH = K + 2 * STRIDE

LAW = 2 * DIM + 2
"""Size of a stage's feedback law: K (2, 10), kappa (2,)."""


class SweepWorkspace(NamedTuple):
    """Workspace of the sweeps of one problem: constants, inputs and results."""

    models: Array  # (N, 10, 12) derivative of each s_(k+1)
    normal: Array  # (N, M, 6) a of the soft rows
    low: Array  # (N, R) lower bounds of g, -inf where there is none
    high: Array  # (N, R) upper bounds of g, inf where there is none
    cap: Array  # (N, R) largest dual: cost of an excess that is 1; inf if the row is hard
    weight: Array  # (N, R) w, input of a sweep
    linear: Array  # (N, R) l, input of a sweep
    g: Array  # (N, R) result of the last sweep
    laws: Array  # (N, LAW) its feedback laws
    Z: Array  # (SCRATCH,) scratch


@jit
def sweep_workspace(lin: Linearisation, target: Array, o: Objective) -> SweepWorkspace:
    """Return the workspace for the sweeps of one problem.

    Parameters
    ----------
    lin : the motion along the nominal trajectory.
    target : (N+1, 3) as in ``Solver.build``.
    o : weights, limits and scales.

    Returns
    -------
    The workspace; weight, linear, g and laws are undefined.
    """
    N, L, P = lin.U.shape[0] - 1, limited_state_count(o), lin.rows.shape[1]
    M = L + P
    R, penalty = HARD_ROWS + M, excess_penalty(lin.X, target, o)
    normal, cap = np.zeros((N, M, NORMAL)), np.full((N, R), np.inf)
    low, high = np.empty((N, R)), np.empty((N, R))
    for k in range(N):
        reach = stage_length(o, k + 1)
        for i in range(2):
            F, change = o.thrust_scale[i], reach * o.max_change[i]
            here, step = lin.U[k + 1, i], lin.U[k + 1, i] - lin.U[k, i]
            lower, upper = command_bounds(lin.U[0, i], o.t[k + 1] * o.max_change[i], o.low[i], o.high[i])
            low[k, i], high[k, i] = (lower - here) / F, (upper - here) / F
            low[k, 2 + i], high[k, 2 + i] = (-change - step) / F, (change - step) / F
        m = 0
        for j in range(len(LIMITED_STATES)):
            if is_limited(o, j):
                i = LIMITED_STATES[j]
                scale, row = o.state_scale[i], HARD_ROWS + m
                normal[k, m, i] = 1.0 / scale
                low[k, row] = (o.low_state[j] - lin.X[k + 1, i]) / scale
                high[k, row] = (o.high_state[j] - lin.X[k + 1, i]) / scale
                cap[k, row] = penalty * reach
                m += 1
        for j in range(P):
            row = HARD_ROWS + L + j
            normal[k, L + j, 0], normal[k, L + j, 1] = lin.rows[k, j, 0], lin.rows[k, j, 1]
            low[k, row], high[k, row] = lin.rows[k, j, 2], np.inf
            if low[k, row] <= -NO_BOUND:
                low[k, row] = -np.inf
            cap[k, row] = lin.rows[k, j, 3]
    weight, linear, g = np.empty((N, R)), np.empty((N, R)), np.empty((N, R))
    laws, Z = np.empty((N, LAW)), np.empty(SCRATCH)
    return SweepWorkspace(_models(lin), normal, low, high, cap, weight, linear, g, laws, Z)


@jit
def _models(lin: Linearisation) -> Array:
    """Return ``SweepWorkspace.models``."""
    N = lin.U.shape[0] - 1
    models = np.zeros((N, DIM, STRIDE))
    for k in range(N):
        for a in range(DIM):
            row = models[k, a]
            if a == 6 or a == 7:
                row[2 + a] = 1.0
                continue
            i = _state(a)
            for j in range(6):
                row[j] = lin.A[k, i, 2 + j]
            for j in range(2):
                row[6 + j], row[8 + j] = lin.B0[k, i, j], lin.B1[k, i, j]
    return models


@jit_outlined
def sweep(lin: Linearisation, target: Array, o: Objective, work: SweepWorkspace, dU: Array) -> bool:
    """Find the deviations of the commands of least cost, by one backward and one forward sweep.

    Parameters
    ----------
    lin : the motion along the nominal trajectory.
    target : (N+1, 3) as in ``Solver.build``.
    o : weights, limits and scales.
    work : its weight and linear are given; its g and laws are overwritten.
    dU : (N+1, 2) is overwritten with the deviations (N).

    Returns
    -------
    False if the cost has no minimum, or the result is not finite.
    """
    if not _backward(lin, target, o, work):
        return False
    _forward(lin, work, dU)
    N = dU.shape[0] - 1
    for k in range(N):
        for i in range(2):
            work.g[k, i] = dU[k + 1, i] / o.thrust_scale[i]
            work.g[k, 2 + i] = (dU[k + 1, i] - dU[k, i]) / o.thrust_scale[i]
    return bool(np.isfinite(dU[N, 0] + dU[N, 1]))


@jit
def _backward(lin: Linearisation, target: Array, o: Objective, work: SweepWorkspace) -> bool:
    """Compute the feedback law of every stage, from the last to the first; False if the cost has no minimum."""
    weight, linear, laws, Z = work.weight, work.linear, work.laws, work.Z
    N = laws.shape[0]
    p = np.zeros(DIM)
    Z[:] = 0.0
    _add_terminal_cost(lin, target, o, Z, p)
    for k in range(N - 1, -1, -1):
        _add_stage_cost(lin, target, o, k + 1, Z, p)
        _add_soft_rows(work, k, Z, p)
        model = work.models[k].ravel()
        for i in range(DIM * STRIDE):
            Z[D + i] = model[i]
        _add_gap(lin, k, Z, p)
        _quadratic_form(Z)
        for i in range(2):
            # s / g |(U_(k+1) - U_k) / F|^2, and the rows of box and slew
            F = o.thrust_scale[i]
            change = o.thrust_change / (stage_length(o, k + 1) * F * F)
            both = change + weight[k, 2 + i] / (F * F)
            slope = change * (lin.U[k + 1, i] - lin.U[k, i]) + linear[k, 2 + i] / F
            Z[Q + (STRIDE + 1) * (8 + i)] += both + weight[k, i] / (F * F)
            Z[Q + (STRIDE + 1) * (6 + i)] += both
            Z[Q + STRIDE * (8 + i) + 6 + i] -= both
            Z[SLOPE + 8 + i] += slope + linear[k, i] / F
            Z[SLOPE + 6 + i] -= slope
        if not _law(Z, laws[k]):
            return False
        if k > 0:
            _value(laws[k], Z, p)
    return True


@jit
def _add_terminal_cost(lin: Linearisation, target: Array, o: Objective, Z: Array, p: Array) -> None:
    """Add the cost of the velocity over ground at the last knot to P and p."""
    N = lin.U.shape[0] - 1
    velocity, V = velocity_over_ground(lin.X[N], lin.C[N])
    for i in range(2):
        for j in range(3):
            p[j] += o.terminal_velocity * V[i, j] * (velocity[i] - target[N, i])
            for m in range(3):
                Z[P + STRIDE * j + m] += o.terminal_velocity * V[i, j] * V[i, m]


@jit
def _add_stage_cost(lin: Linearisation, target: Array, o: Objective, k: int, Z: Array, p: Array) -> None:
    """Add the cost of position, heading and thrust at knot k to P and p."""
    g = stage_length(o, k)
    Z[P + STRIDE * 2 + 2] += o.heading * g
    p[2] += heading_slope(lin.X, target, k, o)
    position = o.position * g + (o.terminal_position if k == lin.U.shape[0] - 1 else 0.0)
    for i in range(2):
        thrust = o.thrust * g / (o.thrust_scale[i] * o.thrust_scale[i])
        Z[P + STRIDE * (6 + i) + 6 + i] += thrust
        p[6 + i] += thrust * lin.U[k, i]
        Z[P + STRIDE * (8 + i) + 8 + i] += position
        p[8 + i] += position * (lin.X[k, i] - target[k - 1, i])


@jit
def _add_soft_rows(work: SweepWorkspace, k: int, Z: Array, p: Array) -> None:
    """Add the terms of the soft rows at knot k + 1 to P and p."""
    for m in range(work.normal.shape[1]):
        a, weight, linear = work.normal[k, m], work.weight[k, HARD_ROWS + m], work.linear[k, HARD_ROWS + m]
        if weight == 0.0 and linear == 0.0:
            continue
        for i in range(NORMAL):
            if a[i] != 0.0:
                p[_entry(i)] += linear * a[i]
                for j in range(NORMAL):
                    Z[P + STRIDE * _entry(i) + _entry(j)] += weight * a[i] * a[j]


@jit
def _state(a: int) -> int:
    """Return the index in X of entry a of s, which is not a command."""
    return 2 + a if a < 6 else a - 8


@jit
def _entry(i: int) -> int:
    """Return the index in s of state i of X: the inverse of ``_state``."""
    return i - 2 if i > 1 else i + 8


@jit
def _quadratic_form(Z: Array) -> None:
    """Compute P D and D' P D, row by row.

    The calls have constant arguments, so that the compiler knows the offsets. One function for the rows of both, with
    the offsets as arguments, is eight times as slow. An argument that is a number, and not a product, would make numba
    compile the function for each number.
    """
    _PD_row(0 * STRIDE, Z)
    _PD_row(1 * STRIDE, Z)
    _PD_row(2 * STRIDE, Z)
    _PD_row(3 * STRIDE, Z)
    _PD_row(4 * STRIDE, Z)
    _PD_row(5 * STRIDE, Z)
    _PD_row(6 * STRIDE, Z)
    _PD_row(7 * STRIDE, Z)
    _PD_row(8 * STRIDE, Z)
    _PD_row(9 * STRIDE, Z)
    _DPD_row(0 * STRIDE, Z)
    _DPD_row(1 * STRIDE, Z)
    _DPD_row(2 * STRIDE, Z)
    _DPD_row(3 * STRIDE, Z)
    _DPD_row(4 * STRIDE, Z)
    _DPD_row(5 * STRIDE, Z)
    _DPD_row(6 * STRIDE, Z)
    _DPD_row(7 * STRIDE, Z)
    _DPD_row(8 * STRIDE, Z)
    _DPD_row(9 * STRIDE, Z)


@jit
def _PD_row(row: int, Z: Array) -> None:
    """Compute the row of P D that begins at ``row``."""
    i = P + row
    p0, p1, p2, p3, p4 = Z[i], Z[i + 1], Z[i + 2], Z[i + 3], Z[i + 4]
    p5, p6, p7, p8, p9 = Z[i + 5], Z[i + 6], Z[i + 7], Z[i + 8], Z[i + 9]
    for j in range(STRIDE):
        Z[W + row + j] = (
            (p0 * Z[D + j] + p1 * Z[D + STRIDE + j])
            + (p2 * Z[D + 2 * STRIDE + j] + p3 * Z[D + 3 * STRIDE + j])
            + (p4 * Z[D + 4 * STRIDE + j] + p5 * Z[D + 5 * STRIDE + j])
            + (p6 * Z[D + 6 * STRIDE + j] + p7 * Z[D + 7 * STRIDE + j])
            + (p8 * Z[D + 8 * STRIDE + j] + p9 * Z[D + 9 * STRIDE + j])
        )


@jit
def _DPD_row(row: int, Z: Array) -> None:
    """Compute the row of D' P D that begins at ``row``."""
    i = D + row // STRIDE
    d0, d1, d2, d3, d4 = Z[i], Z[i + STRIDE], Z[i + 2 * STRIDE], Z[i + 3 * STRIDE], Z[i + 4 * STRIDE]
    d5, d6, d7, d8, d9 = Z[i + 5 * STRIDE], Z[i + 6 * STRIDE], Z[i + 7 * STRIDE], Z[i + 8 * STRIDE], Z[i + 9 * STRIDE]
    for j in range(STRIDE):
        Z[Q + row + j] = (
            (d0 * Z[W + j] + d1 * Z[W + STRIDE + j])
            + (d2 * Z[W + 2 * STRIDE + j] + d3 * Z[W + 3 * STRIDE + j])
            + (d4 * Z[W + 4 * STRIDE + j] + d5 * Z[W + 5 * STRIDE + j])
            + (d6 * Z[W + 6 * STRIDE + j] + d7 * Z[W + 7 * STRIDE + j])
            + (d8 * Z[W + 8 * STRIDE + j] + d9 * Z[W + 9 * STRIDE + j])
        )


@jit
def _add_gap(lin: Linearisation, k: int, Z: Array, p: Array) -> None:
    """Compute p + P gap and D' (p + P gap)."""
    for a in range(DIM):
        Z[P_GAP + a] = p[a]
    for m in range(DIM):
        if m != 6 and m != 7:
            i = _state(m)
            gap = lin.Phi[k, i] - lin.X[k + 1, i]
            if gap != 0.0:  # a solution of the equations of motion has no gaps
                for a in range(DIM):
                    Z[P_GAP + a] += Z[P + STRIDE * m + a] * gap
    for j in range(STRIDE):
        Z[SLOPE + j] = 0.0
    for a in range(DIM):
        x = Z[P_GAP + a]
        for j in range(DIM):
            Z[SLOPE + j] += x * Z[D + STRIDE * a + j]


@jit
def _law(Z: Array, law: Array) -> bool:
    """Compute the law mu = K s + kappa with [K, kappa] = -H^-1 [G, h]; False if H is not positive definite.

    H and G are the last two rows of D' P D; the columns of n and e are those of P D, because n and e are integrated.
    """
    u, v = Q + 8 * STRIDE, Q + 9 * STRIDE
    H00, H01, H11 = Z[u + 8], 0.5 * (Z[u + 9] + Z[v + 8]), Z[v + 9]
    det = H00 * H11 - H01 * H01
    if not (H00 > 0.0 and det > 0.0):
        return False
    for j in range(2):
        Z[u + 8 + j], Z[v + 8 + j] = Z[W + STRIDE * (8 + j) + 8], Z[W + STRIDE * (8 + j) + 9]
    a, b, c = H00 / det, H01 / det, H11 / det
    for j in range(STRIDE):
        Z[K + j] = b * Z[Q + 9 * STRIDE + j] - c * Z[Q + 8 * STRIDE + j]
        Z[K + STRIDE + j] = b * Z[Q + 8 * STRIDE + j] - a * Z[Q + 9 * STRIDE + j]
    for j in range(DIM):
        law[j], law[DIM + j] = Z[K + j], Z[K + STRIDE + j]
    law[2 * DIM] = b * Z[SLOPE + 9] - c * Z[SLOPE + 8]
    law[2 * DIM + 1] = b * Z[SLOPE + 8] - a * Z[SLOPE + 9]
    return True


@jit
def _value(law: Array, Z: Array, p: Array) -> None:
    """Compute P = M + G' K and p = m + G' kappa of the knot before, without the cost of that knot itself.

    M is D' P D for all of s but n and e, which are integrated.
    """
    u, v = Q + 8 * STRIDE, Q + 9 * STRIDE
    for j in range(8):
        p[j] = Z[SLOPE + j] + Z[u + j] * law[2 * DIM] + Z[v + j] * law[2 * DIM + 1]
        Z[Q + STRIDE * j + 8], Z[Q + STRIDE * j + 9] = Z[W + 8 * STRIDE + j], Z[W + 9 * STRIDE + j]
    _P_row(0 * STRIDE, Z)
    _P_row(1 * STRIDE, Z)
    _P_row(2 * STRIDE, Z)
    _P_row(3 * STRIDE, Z)
    _P_row(4 * STRIDE, Z)
    _P_row(5 * STRIDE, Z)
    _P_row(6 * STRIDE, Z)
    _P_row(7 * STRIDE, Z)
    for j in range(8, DIM):
        p[j] = Z[P_GAP + j] + Z[u + j] * law[2 * DIM] + Z[v + j] * law[2 * DIM + 1]
        for m in range(8):
            Z[P + STRIDE * j + m] = Z[P + STRIDE * m + j]
        for m in range(8, j + 1):
            Z[P + STRIDE * j + m] += Z[u + j] * Z[K + m] + Z[v + j] * Z[K + STRIDE + m]
            Z[P + STRIDE * m + j] = Z[P + STRIDE * j + m]


@jit
def _P_row(row: int, Z: Array) -> None:
    """Compute the row of P that begins at ``row``, one of the first eight."""
    a = row // STRIDE
    g0, g1 = Z[Q + 8 * STRIDE + a], Z[Q + 9 * STRIDE + a]
    for j in range(STRIDE):
        Z[P + row + j] = Z[Q + row + j] + g0 * Z[K + j] + g1 * Z[K + STRIDE + j]


@jit
def _forward(lin: Linearisation, work: SweepWorkspace, dU: Array) -> None:
    """Compute the deviations of the commands dU (N+1, 2) under the feedback laws, and the soft rows of g."""
    models, laws = work.models, work.laws
    s, after = np.zeros(DIM), np.empty(DIM)
    dU[0, 0] = dU[0, 1] = 0.0
    for k in range(laws.shape[0]):
        for i in range(2):
            mu = laws[k, 2 * DIM + i]
            for j in range(DIM):
                mu += laws[k, DIM * i + j] * s[j]
            dU[k + 1, i] = mu
        for a in range(DIM):
            if a == 6 or a == 7:
                after[a] = dU[k + 1, a - 6]
                continue
            i = _state(a)
            total = lin.Phi[k, i] - lin.X[k + 1, i] + (s[a] if a > 7 else 0.0)
            for j in range(8):
                total += models[k, a, j] * s[j]
            after[a] = total + models[k, a, 8] * dU[k + 1, 0] + models[k, a, 9] * dU[k + 1, 1]
        for a in range(DIM):
            s[a] = after[a]
        for m in range(work.normal.shape[1]):
            total = 0.0
            for i in range(NORMAL):
                total += work.normal[k, m, i] * s[_entry(i)]
            work.g[k, HARD_ROWS + m] = total
