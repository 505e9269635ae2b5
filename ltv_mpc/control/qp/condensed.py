"""The condensed QP of the LTV-MPC: the sparse one (sparse.py) with its states eliminated, unknowns the commands alone.

With Q_k the weights on the state at knot k = 1 .. N (w on p; at N also w_N on p and m V'V from p'_N), the deviations
dX_k = d_k + sum_j S_k^j dU_j consist of what the gaps alone do and of what the commands add:

    d_(k+1) = A_k d_k + Phi_k - Xbar_(k+1),   d_0 = 0
    S_j^j = B1_(j-1),   S_(j+1)^j = A_j S_j^j + B0_j = D_j,   S_(k+1)^j = A_k S_k^j

    H_ij = sum over k >= i of (S_k^i)' Q_k S_k^j = G_i' S_i^j                          for i > j
    H_ii = B1_(i-1)' Q_i B1_(i-1) + D_i' W_(i+1) D_i
    G_i = Q_i B1_(i-1) + A_i' W_(i+1) D_i,   W_k = Q_k + A_k' W_(k+1) A_k,   W_N = Q_N
    f_i = B1_(i-1)' mu_i + B0_i' mu_(i+1),   mu_k = Q_k d_k + c_k + A_k' mu_(k+1)

with c_k the cost's slope at Xbar. So H takes O(N^2) where the product of the sensitivities takes O(N^3) (Andersson,
Frison: "condensing with O(N^2)"). To H and f the thrust terms of the cost are added. Of A only what can be other than
zero is used: positions carry over and act on nothing else, a thrust depends on itself alone.

Unknowns z = [dU_1 / F, .., dU_N / F] (2N,), as in sparse.py. The bounds are those of z, then of the slew rows
z_k - z_(k-1), k = 2 .. N; that from knot 0, where the command is given, to knot 1 is a bound of z_1.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy.sparse import csc_array, eye_array, vstack

from ltv_mpc.compiled import kernel
from ltv_mpc.control.config import Weights
from ltv_mpc.control.constants import Objective, length, objective, pack_objective
from ltv_mpc.control.horizon import Linearisation, times, transposed_times, velocity_over_ground
from ltv_mpc.control.limits import HorizonLimits, bounds
from ltv_mpc.control.qp import rows
from ltv_mpc.control.qp.problem import QP
from ltv_mpc.control.qp.rows import Row
from ltv_mpc.messages import Array
from ltv_mpc.vehicle.flow import STATES


class CondensedForm:
    """The QP's numbers for given knots: minimise 1/2 z' H z + f' z subject to lower <= [z, A z] <= upper."""

    def __init__(self, knots: Array, limits: HorizonLimits, weights: Weights) -> None:
        """``knots`` (N+1,) as in ``grid.py``, ``limits`` and ``weights`` stay the same, and so does A."""
        self.stages = stages = len(knots) - 1
        n = 2 * stages
        self.A = _slew_rows(stages)  # (2N-2, 2N)
        self.H = np.zeros((n, n))
        self.f = np.zeros(n)
        self.lower = np.zeros(2 * n - 2)
        self.upper = np.zeros(2 * n - 2)
        self._numbers = pack_objective(knots, limits, weights)
        self._scale = limits.scale
        self._S = np.zeros((2, STATES, n))

    def build(self, lin: Linearisation, target: Array) -> bool:
        """The numbers of one cycle, and whether they are finite; ``target`` (N+1, 2) as in ``Solver``."""
        return _build(*lin[:-1], target, self._numbers, self._S, self.H, self.f, self.lower, self.upper)

    def commands(self, lin: Linearisation, z: Array) -> tuple[Array, bool]:
        """Commands (N+1, 2) at the knots of a solution z (2N,), and whether they are finite."""
        return commands(lin.U, z, self._scale)

    @cached_property
    def row_names(self) -> tuple[Row, ...]:
        """What each row is."""
        stages = range(1, self.stages + 1)
        return (*rows.box(stages, self._scale), *rows.slew(stages[1:], self._scale))

    def problem(self) -> QP:
        """The QP last built: rows of z first, then the slew rows."""
        A = vstack([eye_array(2 * self.stages), csc_array(self.A)], format="csc")
        return QP(csc_array(self.H), self.f.copy(), csc_array(A), self.lower.copy(), self.upper.copy())


def _slew_rows(stages: int) -> Array:
    """z_k - z_(k-1) for k = 2 .. N, (2N-2, 2N)."""
    n = 2 * stages
    return np.eye(n - 2, n, 2) - np.eye(n - 2, n)


@kernel
def _build(
    X: Array,
    U: Array,
    C: Array,
    Phi: Array,
    A: Array,
    B0: Array,
    B1: Array,
    target: Array,
    numbers: Array,
    S: Array,
    H: Array,
    f: Array,
    lower: Array,
    upper: Array,
) -> bool:
    """H (2N, 2N), f (2N,) and the bounds (4N-2,) in place; S (2, 8, 2N) is scratch."""
    o = objective(numbers)
    slope = gradient(X, U, C, Phi, A, B0, B1, target, o, f)
    _hessian(A, B0, B1, slope, o, S, H)
    thrust_bounds(U, o, lower, upper)
    # A NaN or an infinity anywhere shows in a sum of all.
    total = f.sum() + lower.sum() + upper.sum()
    for i in range(H.shape[0]):
        for j in range(i + 1):
            total += H[i, j]
    return bool(np.isfinite(total))


@kernel
def commands(U: Array, z: Array, scale: Array) -> tuple[Array, bool]:
    """U (N+1, 2) + scale z, z (2N,) at the knots 1 .. N, and whether all are finite."""
    out = U.copy()
    total = 0.0
    for k in range(1, U.shape[0]):
        for i in range(2):
            out[k, i] += scale[i] * z[2 * k - 2 + i]
            total += out[k, i]
    return out, bool(np.isfinite(total))


@kernel
def thrust_bounds(U: Array, o: Objective, lower: Array, upper: Array) -> None:
    """Bounds of z and of the slew rows, in place."""
    N = U.shape[0] - 1
    for k in range(1, N + 1):
        for i in range(2):
            here = 2 * k - 2 + i
            change = length(o, k) * o.change[i]
            least, most = bounds(U[0, i], o.t[k] * o.change[i], o.low[i], o.high[i])
            if k == 1:
                least = max(least, U[0, i] - change)
                most = min(most, U[0, i] + change)
            else:
                step = U[k, i] - U[k - 1, i]
                slew = 2 * N + here - 2
                lower[slew] = (-change - step) / o.scale[i]
                upper[slew] = (change - step) / o.scale[i]
            lower[here] = (least - U[k, i]) / o.scale[i]
            upper[here] = (most - U[k, i]) / o.scale[i]


@kernel
def gradient(
    X: Array,
    U: Array,
    C: Array,
    Phi: Array,
    A: Array,
    B0: Array,
    B1: Array,
    target: Array,
    o: Objective,
    f: Array,
) -> Array:
    """f (2N,) in place; the slope V (2, 3) of the velocity over ground at the end."""
    N = U.shape[0] - 1
    x, y = np.zeros(STATES), np.zeros(STATES)
    mu = np.zeros((N + 1, STATES))
    # d_k: what the gaps do
    for k in range(N):
        times(A, k, x, y)
        for i in range(STATES):
            x[i] = y[i] + Phi[k, i] - X[k + 1, i]
        for i in range(2):
            mu[k + 1, i] = o.position * length(o, k + 1) * (X[k + 1, i] + x[i] - target[k, i])
    velocity, slope = velocity_over_ground(X[N], C[N])
    for i in range(2):
        mu[N, i] += o.terminal_position * (X[N, i] + x[i] - target[N - 1, i])
        end = velocity[i] - target[N, i] + slope[i, 0] * x[2] + slope[i, 1] * x[3] + slope[i, 2] * x[4]
        for j in range(3):
            mu[N, 2 + j] += o.terminal_velocity * slope[i, j] * end
    for k in range(N, 0, -1):
        g = length(o, k)
        if k < N:
            transposed_times(A, k, mu[k + 1], y)
            for i in range(STATES):
                mu[k, i] += y[i]
        for j in range(2):
            total = 0.0
            for i in range(STATES):
                total += B1[k - 1, i, j] * mu[k, i]
            slewed = (U[k, j] - U[k - 1, j]) / g
            if k < N:
                for i in range(STATES):
                    total += B0[k, i, j] * mu[k + 1, i]
                slewed -= (U[k + 1, j] - U[k, j]) / length(o, k + 1)
            f[2 * k - 2 + j] = total * o.scale[j] + (o.thrust * g * U[k, j] + o.thrust_change * slewed) / o.scale[j]
    return slope


@kernel
def _back(A: Array, W: Array, WA: Array) -> None:
    """W = A' W A in place, W (8, 8) symmetric; WA (8, 8) is scratch."""
    for i in range(STATES):
        WA[i, 0], WA[i, 1] = W[i, 0], W[i, 1]
        for j in range(2, STATES):
            WA[i, j] = (
                W[i, 0] * A[0, j]
                + W[i, 1] * A[1, j]
                + W[i, 2] * A[2, j]
                + W[i, 3] * A[3, j]
                + W[i, 4] * A[4, j]
                + W[i, 5] * A[5, j]
            )
        WA[i, 6] += W[i, 6] * A[6, 6]
        WA[i, 7] += W[i, 7] * A[7, 7]
    for j in range(STATES):
        W[0, j], W[1, j] = WA[0, j], WA[1, j]
    for i in range(2, STATES):
        for j in range(STATES):
            W[i, j] = (
                A[0, i] * WA[0, j]
                + A[1, i] * WA[1, j]
                + A[2, i] * WA[2, j]
                + A[3, i] * WA[3, j]
                + A[4, i] * WA[4, j]
                + A[5, i] * WA[5, j]
            )
    for j in range(STATES):
        W[6, j] += A[6, 6] * WA[6, j]
        W[7, j] += A[7, 7] * WA[7, j]


@kernel
def _hessian(A: Array, B0: Array, B1: Array, slope: Array, o: Objective, S: Array, H: Array) -> None:
    """H (2N, 2N) in place; ``slope`` (2, 3) is V; S (2, 8, 2N) is scratch."""
    N = A.shape[0]
    G = np.empty((N + 1, STATES, 2))
    W, WA = np.zeros((STATES, STATES)), np.empty((STATES, STATES))
    D, WD, g = np.empty(STATES), np.empty(STATES), np.empty(STATES)

    # Backwards: W, G and the diagonal blocks. W_(N+1) = 0, and Q_N holds more than the weight on the positions.
    for k in range(N, 0, -1):
        B = B1[k - 1]
        for j in range(2):
            if k < N:
                times(A, k, B[:, j], D)
                for i in range(STATES):
                    D[i] += B0[k, i, j]
                product(W, D, WD)
                transposed_times(A, k, WD, g)
            else:
                g[:] = 0.0
                for i in range(3):
                    for m in range(3):
                        both = slope[0, i] * slope[0, m] + slope[1, i] * slope[1, m]
                        g[2 + i] += o.terminal_velocity * both * B[2 + m, j]
            weight = o.position * length(o, k) + (o.terminal_position if k == N else 0.0)
            for i in range(2):
                # B1_i' Q B1_j + D_i' W D_j,  with D_i = A B1_i + B0_i
                total = weight * (B[0, i] * B[0, j] + B[1, i] * B[1, j])
                for m in range(STATES):
                    total += B[m, i] * g[m]
                if k < N:
                    for m in range(STATES):
                        total += B0[k, m, i] * WD[m]
                H[2 * k - 2 + i, 2 * k - 2 + j] = total * o.scale[i] * o.scale[j]
            for i in range(STATES):
                G[k, i, j] = g[i]
            G[k, 0, j] += weight * B[0, j]
            G[k, 1, j] += weight * B[1, j]
        if k < N:
            _back(A[k], W, WA)
        else:
            W[0, 0] = W[1, 1] = o.terminal_position
            for i in range(3):
                for j in range(3):
                    W[2 + i, 2 + j] = o.terminal_velocity * (slope[0, i] * slope[0, j] + slope[1, i] * slope[1, j])
        W[0, 0] += o.position * length(o, k)
        W[1, 1] += o.position * length(o, k)

    # Forwards: the sensitivities, and from them the rest of H
    for k in range(1, N + 1):
        new, old = S[k % 2], S[(k + 1) % 2]
        first = 2 * k - 2
        if k > 1:
            _forward(A[k - 1], old, first, new)
            for i in range(STATES):
                for j in range(2):
                    new[i, first - 2 + j] += B0[k - 1, i, j] * o.scale[j]
            for i in range(2):
                _row(G[k], i, o.scale[i], new, first, H[first + i])
        for i in range(STATES):
            for j in range(2):
                new[i, first + j] = B1[k - 1, i, j] * o.scale[j]
    for i in range(2 * N):
        for j in range(i):
            H[j, i] = H[i, j]
    thrust_terms(o, H)


@kernel
def product(W: Array, x: Array, out: Array) -> None:
    """out = W x: W (8, 8) symmetric, x and out (8,)."""
    out[:] = 0.0
    for j in range(STATES):
        for i in range(STATES):
            out[i] += W[j, i] * x[j]


@kernel
def _forward(A: Array, old: Array, columns: int, new: Array) -> None:
    """new = A old in the first columns."""
    c0, c1, c2, c3, c4, c5, c6, c7 = old[0], old[1], old[2], old[3], old[4], old[5], old[6], old[7]
    for i in range(6):
        out = new[i]
        carry = c0 if i == 0 else c1
        a2, a3, a4, a5, a6, a7 = A[i, 2], A[i, 3], A[i, 4], A[i, 5], A[i, 6], A[i, 7]
        if i < 2:
            for j in range(columns):
                out[j] = carry[j] + a2 * c2[j] + a3 * c3[j] + a4 * c4[j] + a5 * c5[j] + a6 * c6[j] + a7 * c7[j]
        else:
            for j in range(columns):
                out[j] = a2 * c2[j] + a3 * c3[j] + a4 * c4[j] + a5 * c5[j] + a6 * c6[j] + a7 * c7[j]
    for i in range(6, 8):
        out, one, a = new[i], old[i], A[i, i]
        for j in range(columns):
            out[j] = a * one[j]


@kernel
def _row(G: Array, i: int, scale: float, S: Array, columns: int, out: Array) -> None:
    """out = scale G[:, i]' S in the first columns."""
    g0, g1, g2, g3 = scale * G[0, i], scale * G[1, i], scale * G[2, i], scale * G[3, i]
    g4, g5, g6, g7 = scale * G[4, i], scale * G[5, i], scale * G[6, i], scale * G[7, i]
    s0, s1, s2, s3, s4, s5, s6, s7 = S[0], S[1], S[2], S[3], S[4], S[5], S[6], S[7]
    for j in range(columns):
        out[j] = g0 * s0[j] + g1 * s1[j] + g2 * s2[j] + g3 * s3[j] + g4 * s4[j] + g5 * s5[j] + g6 * s6[j] + g7 * s7[j]


@kernel
def thrust_terms(o: Objective, H: Array) -> None:
    """The second derivatives of g_k r |z_k|^2 / 2 + s / g_k |z_k - z_(k-1)|^2 / 2 on top of H (2N, 2N)."""
    n = H.shape[0]
    for i in range(n):
        g = length(o, i // 2 + 1)
        H[i, i] += o.thrust * g + o.thrust_change / g
        if i < n - 2:
            s = o.thrust_change / length(o, i // 2 + 2)
            H[i, i] += s
            H[i, i + 2] -= s
            H[i + 2, i] -= s
