"""The QP along its stages: Riccati's sweeps, which solve it where no inequality is left.

    minimise   the QP's cost (``sparse.py``)  +  sum over k = 1..N, i of   1/2 w g^2 + l g,   g = [z_k, z_k - z_(k-1)]
    subject to the dynamics,   z_k = dU_k / F (2,)

``weight`` w and ``linear`` l (N, 4) are what a method that deals with box and slew (``solvers/riccati_solver.py``)
makes of
them; g are the rows of both, in the order [box of port, of starboard, slew of port, of starboard].

What the rest depends on at knot k is s = [dX_k, dU_k] (10,), and the input mu = dU_(k+1):

    s_(k+1) = [A_k dX_k + B0_k dU_k + B1_k mu + gap_k,  mu],      gap_k = Phi_k - Xbar_(k+1)
    V_k(s)  = cost of knot k + min over mu of  cost of the change + V_(k+1)(s_(k+1)) = 1/2 s' P s + p' s

A sweep backward gives P, p and the law mu = K s + kappa, one forward the commands. Both together are some 2000 products
a stage, and cost as much as two or three iterations of OSQP (Rao, Wright & Rawlings 1998).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ltv_mpc.control.horizon_limits import command_bounds
from ltv_mpc.control.linearisation import Linearisation, velocity_over_ground
from ltv_mpc.control.problem_data import Objective, stage_length
from ltv_mpc.jit import jit
from ltv_mpc.messages import Array

LIMIT_ROWS = 4
"""g of a stage."""

WIDE = 10
"""s = [u, v, psi, r, F1, F2, U1, U2, n, e]; and as many are what s_(k+1) depends on besides n and e, which carry over:
[u, v, psi, r, F1, F2, U1, U2, mu1, mu2].
"""
ROW = 12
"""Room for a row of so many numbers: whole vector registers."""
D, P, W, Q = 0, ROW * WIDE, 2 * ROW * WIDE, 3 * ROW * WIDE
"""Where in the scratch array: ds_(k+1); P; P D; D' P D. It is one array, and most places in it are written out, for the
reason that ``vehicle/sensitivity.py`` gives: four times as fast.
"""
AHEAD, SLOPE, K = 4 * ROW * WIDE, 4 * ROW * WIDE + ROW, 4 * ROW * WIDE + 2 * ROW
"""p + P gap; D' of it; both rows of K."""
SCRATCH = K + 2 * ROW

LAW = 2 * WIDE + 2
"""Numbers of a stage's law: K (2, 10), kappa (2,)."""


class SweepWorkspace(NamedTuple):
    """What the sweeps of one problem share, and what each of them is told and says."""

    models: Array  # (N, 10, 12) what every s_(k+1) depends on
    low: Array  # (N, 4) between what g must stay
    high: Array
    weight: Array  # (N, 4) w and l: to be filled in before a sweep
    linear: Array
    g: Array  # (N, 4) that the last sweep came to
    laws: Array  # (N, LAW) its laws
    Z: Array  # (SCRATCH,)


@jit
def sweep_workspace(lin: Linearisation, o: Objective) -> SweepWorkspace:
    """For as many sweeps as it takes."""
    N = lin.U.shape[0] - 1
    low, high = np.empty((N, LIMIT_ROWS)), np.empty((N, LIMIT_ROWS))
    for k in range(N):
        reach = stage_length(o, k + 1)
        for i in range(2):
            F, change = o.scale[i], reach * o.max_change[i]
            here, step = lin.U[k + 1, i], lin.U[k + 1, i] - lin.U[k, i]
            least, most = command_bounds(lin.U[0, i], o.t[k + 1] * o.max_change[i], o.low[i], o.high[i])
            low[k, i], high[k, i] = (least - here) / F, (most - here) / F
            low[k, 2 + i], high[k, 2 + i] = (-change - step) / F, (change - step) / F
    weight, linear, g = np.empty((N, LIMIT_ROWS)), np.empty((N, LIMIT_ROWS)), np.empty((N, LIMIT_ROWS))
    return SweepWorkspace(_models(lin), low, high, weight, linear, g, np.empty((N, LAW)), np.empty(SCRATCH))


@jit
def _models(lin: Linearisation) -> Array:
    """Of every stage, as ``SweepWorkspace`` has them."""
    N = lin.U.shape[0] - 1
    models = np.zeros((N, WIDE, ROW))
    for k in range(N):
        for a in range(WIDE):
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


@jit
def sweep(lin: Linearisation, target: Array, o: Objective, work: SweepWorkspace, dU: Array) -> bool:
    """dU (N+1, 2): deviations of the commands (N) that cost least, and ``work.g`` of them. False where there are none
    such, or not finite. ``target`` as in ``Solver``.
    """
    if not _backward(lin, target, o, work):
        return False
    _forward(lin, work.models, work.laws, dU)
    N = dU.shape[0] - 1
    for k in range(N):
        for i in range(2):
            work.g[k, i] = dU[k + 1, i] / o.scale[i]
            work.g[k, 2 + i] = (dU[k + 1, i] - dU[k, i]) / o.scale[i]
    return bool(np.isfinite(dU[N, 0] + dU[N, 1]))


@jit
def _backward(lin: Linearisation, target: Array, o: Objective, work: SweepWorkspace) -> bool:
    """The law of every stage, from the last one on."""
    weight, linear, laws, Z = work.weight, work.linear, work.laws, work.Z
    N = laws.shape[0]
    p = np.zeros(WIDE)
    Z[:] = 0.0
    _add_end(lin, target, o, Z, p)
    for k in range(N - 1, -1, -1):
        _add_knot(lin, target, o, k + 1, Z, p)
        model = work.models[k].ravel()
        for i in range(WIDE * ROW):
            Z[D + i] = model[i]
        _drift(lin, k, Z, p)
        _square(Z)
        for i in range(2):
            # s / g |(U_(k+1) - U_k) / F|^2, and the rows of box and slew
            F = o.scale[i]
            change = o.thrust_change / (stage_length(o, k + 1) * F * F)
            both = change + weight[k, 2 + i] / (F * F)
            slope = change * (lin.U[k + 1, i] - lin.U[k, i]) + linear[k, 2 + i] / F
            Z[Q + (ROW + 1) * (8 + i)] += both + weight[k, i] / (F * F)
            Z[Q + (ROW + 1) * (6 + i)] += both
            Z[Q + ROW * (8 + i) + 6 + i] -= both
            Z[SLOPE + 8 + i] += slope + linear[k, i] / F
            Z[SLOPE + 6 + i] -= slope
        if not _law(Z, laws[k]):
            return False
        if k > 0:
            _value(laws[k], Z, p)
    return True


@jit
def _add_end(lin: Linearisation, target: Array, o: Objective, Z: Array, p: Array) -> None:
    """What the velocity over ground at the last knot costs, to P and p."""
    N = lin.U.shape[0] - 1
    velocity, V = velocity_over_ground(lin.X[N], lin.C[N])
    for i in range(2):
        for j in range(3):
            p[j] += o.terminal_velocity * V[i, j] * (velocity[i] - target[N, i])
            for m in range(3):
                Z[P + ROW * j + m] += o.terminal_velocity * V[i, j] * V[i, m]


@jit
def _add_knot(lin: Linearisation, target: Array, o: Objective, k: int, Z: Array, p: Array) -> None:
    """What position and thrust at knot k cost, to P and p."""
    g = stage_length(o, k)
    position = o.position * g + (o.terminal_position if k == lin.U.shape[0] - 1 else 0.0)
    for i in range(2):
        thrust = o.thrust * g / (o.scale[i] * o.scale[i])
        Z[P + ROW * (6 + i) + 6 + i] += thrust
        p[6 + i] += thrust * lin.U[k, i]
        Z[P + ROW * (8 + i) + 8 + i] += position
        p[8 + i] += position * (lin.X[k, i] - target[k - 1, i])


@jit
def _state(a: int) -> int:
    """Where entry a of s stands in X; of both commands, nowhere."""
    return 2 + a if a < 6 else a - 8


@jit
def _square(Z: Array) -> None:
    """P D, row by row, and D' P D: as calls with constants, so that the compiler sees which numbers are whose. One
    function for the rows of both, told where they are, it does not take apart any more: eight times as slow.
    """
    _row_of_PD(0, Z)
    _row_of_PD(1, Z)
    _row_of_PD(2, Z)
    _row_of_PD(3, Z)
    _row_of_PD(4, Z)
    _row_of_PD(5, Z)
    _row_of_PD(6, Z)
    _row_of_PD(7, Z)
    _row_of_PD(8, Z)
    _row_of_PD(9, Z)
    _row_of_DPD(0, Z)
    _row_of_DPD(1, Z)
    _row_of_DPD(2, Z)
    _row_of_DPD(3, Z)
    _row_of_DPD(4, Z)
    _row_of_DPD(5, Z)
    _row_of_DPD(6, Z)
    _row_of_DPD(7, Z)
    _row_of_DPD(8, Z)
    _row_of_DPD(9, Z)


@jit
def _row_of_PD(a: int, Z: Array) -> None:
    i = P + ROW * a
    p0, p1, p2, p3, p4 = Z[i], Z[i + 1], Z[i + 2], Z[i + 3], Z[i + 4]
    p5, p6, p7, p8, p9 = Z[i + 5], Z[i + 6], Z[i + 7], Z[i + 8], Z[i + 9]
    for j in range(ROW):
        Z[W + ROW * a + j] = (
            (p0 * Z[D + j] + p1 * Z[D + ROW + j])
            + (p2 * Z[D + 2 * ROW + j] + p3 * Z[D + 3 * ROW + j])
            + (p4 * Z[D + 4 * ROW + j] + p5 * Z[D + 5 * ROW + j])
            + (p6 * Z[D + 6 * ROW + j] + p7 * Z[D + 7 * ROW + j])
            + (p8 * Z[D + 8 * ROW + j] + p9 * Z[D + 9 * ROW + j])
        )


@jit
def _row_of_DPD(a: int, Z: Array) -> None:
    i = D + a
    d0, d1, d2, d3, d4 = Z[i], Z[i + ROW], Z[i + 2 * ROW], Z[i + 3 * ROW], Z[i + 4 * ROW]
    d5, d6, d7, d8, d9 = Z[i + 5 * ROW], Z[i + 6 * ROW], Z[i + 7 * ROW], Z[i + 8 * ROW], Z[i + 9 * ROW]
    for j in range(ROW):
        Z[Q + ROW * a + j] = (
            (d0 * Z[W + j] + d1 * Z[W + ROW + j])
            + (d2 * Z[W + 2 * ROW + j] + d3 * Z[W + 3 * ROW + j])
            + (d4 * Z[W + 4 * ROW + j] + d5 * Z[W + 5 * ROW + j])
            + (d6 * Z[W + 6 * ROW + j] + d7 * Z[W + 7 * ROW + j])
            + (d8 * Z[W + 8 * ROW + j] + d9 * Z[W + 9 * ROW + j])
        )


@jit
def _drift(lin: Linearisation, k: int, Z: Array, p: Array) -> None:
    """p + P gap, and D' of it."""
    for a in range(WIDE):
        Z[AHEAD + a] = p[a]
    for m in range(WIDE):
        if m != 6 and m != 7:
            i = _state(m)
            gap = lin.Phi[k, i] - lin.X[k + 1, i]
            if gap != 0.0:  # along a solution of the equations of motion there is none
                for a in range(WIDE):
                    Z[AHEAD + a] += Z[P + ROW * m + a] * gap
    for j in range(ROW):
        Z[SLOPE + j] = 0.0
    for a in range(WIDE):
        x = Z[AHEAD + a]
        for j in range(WIDE):
            Z[SLOPE + j] += x * Z[D + ROW * a + j]


@jit
def _law(Z: Array, law: Array) -> bool:
    """mu = K s + kappa, [K, kappa] = -H^-1 [G, h]; false where H is not positive definite.

    H and G are the last two rows of D' P D; the columns of n and e, which carry over, are those of P D.
    """
    u, v = Q + 8 * ROW, Q + 9 * ROW
    H00, H01, H11 = Z[u + 8], 0.5 * (Z[u + 9] + Z[v + 8]), Z[v + 9]
    det = H00 * H11 - H01 * H01
    if not (H00 > 0.0 and det > 0.0):
        return False
    for j in range(2):
        Z[u + 8 + j], Z[v + 8 + j] = Z[W + ROW * (8 + j) + 8], Z[W + ROW * (8 + j) + 9]
    a, b, c = H00 / det, H01 / det, H11 / det
    for j in range(ROW):
        Z[K + j] = b * Z[Q + 9 * ROW + j] - c * Z[Q + 8 * ROW + j]
        Z[K + ROW + j] = b * Z[Q + 8 * ROW + j] - a * Z[Q + 9 * ROW + j]
    for j in range(WIDE):
        law[j], law[WIDE + j] = Z[K + j], Z[K + ROW + j]
    law[2 * WIDE] = b * Z[SLOPE + 9] - c * Z[SLOPE + 8]
    law[2 * WIDE + 1] = b * Z[SLOPE + 8] - a * Z[SLOPE + 9]
    return True


@jit
def _value(law: Array, Z: Array, p: Array) -> None:
    """P and p of the knot before, without what that knot itself costs: P = M + G' K, p = m + G' kappa, with D' P D the
    M of all that s has but n and e, which carry over.
    """
    u, v = Q + 8 * ROW, Q + 9 * ROW
    for j in range(8):
        p[j] = Z[SLOPE + j] + Z[u + j] * law[2 * WIDE] + Z[v + j] * law[2 * WIDE + 1]
        Z[Q + ROW * j + 8], Z[Q + ROW * j + 9] = Z[W + 8 * ROW + j], Z[W + 9 * ROW + j]
    _row_of_P(0, Z)
    _row_of_P(1, Z)
    _row_of_P(2, Z)
    _row_of_P(3, Z)
    _row_of_P(4, Z)
    _row_of_P(5, Z)
    _row_of_P(6, Z)
    _row_of_P(7, Z)
    for j in range(8, WIDE):
        p[j] = Z[AHEAD + j] + Z[u + j] * law[2 * WIDE] + Z[v + j] * law[2 * WIDE + 1]
        for m in range(8):
            Z[P + ROW * j + m] = Z[P + ROW * m + j]
        for m in range(8, j + 1):
            Z[P + ROW * j + m] += Z[u + j] * Z[K + m] + Z[v + j] * Z[K + ROW + m]
            Z[P + ROW * m + j] = Z[P + ROW * j + m]


@jit
def _row_of_P(a: int, Z: Array) -> None:
    g0, g1 = Z[Q + 8 * ROW + a], Z[Q + 9 * ROW + a]
    for j in range(ROW):
        Z[P + ROW * a + j] = Z[Q + ROW * a + j] + g0 * Z[K + j] + g1 * Z[K + ROW + j]


@jit
def _forward(lin: Linearisation, models: Array, laws: Array, dU: Array) -> None:
    """The commands under the laws."""
    s, after = np.zeros(WIDE), np.empty(WIDE)
    dU[0, 0] = dU[0, 1] = 0.0
    for k in range(laws.shape[0]):
        for i in range(2):
            mu = laws[k, 2 * WIDE + i]
            for j in range(WIDE):
                mu += laws[k, WIDE * i + j] * s[j]
            dU[k + 1, i] = mu
        for a in range(WIDE):
            if a == 6 or a == 7:
                after[a] = dU[k + 1, a - 6]
                continue
            i = _state(a)
            total = lin.Phi[k, i] - lin.X[k + 1, i] + (s[a] if a > 7 else 0.0)
            for j in range(8):
                total += models[k, a, j] * s[j]
            after[a] = total + models[k, a, 8] * dU[k + 1, 0] + models[k, a, 9] * dU[k + 1, 1]
        for a in range(WIDE):
            s[a] = after[a]
