"""One Kalman update by the rows of one message, with an innovation gate: of a covariance, and of a belief.

S = H P H^T + R,  each row passes if residual_i^2 / S_ii <= gate;  of those that pass, with S = L L^T, W = L^-1 H P:
    error = W^T L^-1 residual,   P := P - W^T W
``weigh`` says what the rows tell of the error, ``reduce`` what then is left of the covariance, ``update`` does both on
any P; ``correct`` moves a belief by the error and carries P over to the estimate that has moved (``turning.py``).
Exact   P stays symmetric to the last bit: of few rows both triangles are reckoned by the same sums, of many one
        triangle is, and the other written from it tile by tile.
Cost    H is sparse: H P costs m w n, S m^2 w, W m^2 n, W^T W m n^2 / 2; then one pass over P.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.linalg.blas import dsyrk, dtrsm, dtrsv
from scipy.linalg.lapack import dpotrf

from ltv_mpc.compiled import assign, kernel
from ltv_mpc.localisation.measurements.rows import Rows
from ltv_mpc.localisation.state import Belief
from ltv_mpc.localisation.turning import HEADING, swing
from ltv_mpc.signals import Array

_FEW = 4
"""Rows up to which no library is called: its calls would take longer than the sums, and be another pass over P."""

_TILE = 32
"""Two tiles of P, 16 kB, stay in the innermost cache while one becomes the other's transpose."""


class Correction(NamedTuple):
    """What came of each row. ``nis`` is residual^2 / S_ii, before the gate: chi-square of one degree of freedom."""

    accepted: npt.NDArray[np.bool_]
    nis: Array
    S: Array  # (m, m), of all rows
    definite: bool  # S was positive definite; if not, nothing has been touched, and P must not be trusted
    error: Array  # (n,), of the estimate: what is to be added to it; zero if no row passed
    told: Array  # (n,), diagonal of W^T W: by how much the variances become less


@kernel
def _project(P: Array, state: npt.NDArray[np.int64], partial: Array, variance: Array) -> tuple[Array, Array]:
    """H P, (m, n), and S = H P H^T + R, (m, m)."""
    m, w = state.shape
    n = P.shape[0]
    HP, S = np.zeros((m, n)), np.zeros((m, m))
    for i in range(m):
        for a in range(w):
            c, s = partial[i, a], state[i, a]
            if c != 0.0:
                for k in range(n):
                    HP[i, k] += c * P[s, k]
    PH = np.empty((n, m))  # whose rows S is a sum of: all at once, where rows of H P would be picked one by one
    for i in range(m):
        for k in range(n):
            PH[k, i] = HP[i, k]
    for j in range(m):
        for a in range(w):
            c, s = partial[j, a], state[j, a]
            if c != 0.0:
                for i in range(j, m):
                    S[j, i] += c * PH[s, i]
        for i in range(j):
            S[j, i] = S[i, j]
        S[j, j] += variance[j]
    return HP, S


@kernel
def _fold(HP: Array, S: Array, residual: Array) -> tuple[bool, Array]:
    """S = L L^T; HP := L^-1 HP = W and residual := L^-1 residual, in place; the error W^T L^-1 residual, (n,).

    False and anything if S is not definite.
    """
    m, n = HP.shape
    L = np.zeros((m, m))
    error = np.zeros(n)
    for i in range(m):
        for j in range(i + 1):
            s = S[i, j]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            if i > j:
                L[i, j] = s / L[j, j]
            elif s > 0.0:
                L[i, i] = math.sqrt(s)
            else:
                return False, error
        for k in range(i):
            c = L[i, k]
            residual[i] -= c * residual[k]
            for j in range(n):
                HP[i, j] -= c * HP[k, j]
        residual[i] /= L[i, i]
        for j in range(n):
            HP[i, j] /= L[i, i]
            error[j] += HP[i, j] * residual[i]
    return True, error


@kernel
def _subtract(P: Array, W: Array, a: Array, b: Array) -> None:
    """P := P - W^T W + a b^T + b a^T, all of it: each element and its mirror image by the same sums, so to the bit."""
    n, m = P.shape[0], W.shape[0]
    for i in range(n):
        ai, bi = a[i], b[i]
        if m == 1:  # as most messages are: one loop instead of two
            wi = W[0, i]
            for j in range(n):
                P[i, j] += (ai * b[j] + bi * a[j]) - wi * W[0, j]
            continue
        for j in range(n):
            P[i, j] += ai * b[j] + bi * a[j]
        for k in range(m):
            wi = W[k, i]
            for j in range(n):
                P[i, j] -= wi * W[k, j]


@kernel
def _mirror(P: Array, a: Array, b: Array) -> None:
    """P := P + a b^T + b a^T, of which only the upper triangle is read, and both are written, tile by tile."""
    n = P.shape[0]
    for top in range(0, n, _TILE):
        bottom = min(top + _TILE, n)
        for left in range(top, n, _TILE):
            right = min(left + _TILE, n)
            for i in range(top, bottom):
                ai, bi = a[i], b[i]
                for j in range(max(i, left), right):
                    P[i, j] += ai * b[j] + bi * a[j]
            for j in range(left, right):
                for i in range(top, min(bottom, j)):
                    P[j, i] = P[i, j]


@kernel
def _weigh_few(
    P: Array, state: npt.NDArray[np.int64], partial: Array, z: Array, variance: Array, gate: float
) -> tuple[npt.NDArray[np.bool_], Array, Array, bool, Array, Array, Array]:
    """The fields of a ``Correction``, and W, of few rows: without a library's calls."""
    HP, S = _project(P, state, partial, variance)
    m, n = HP.shape
    accepted, nis = np.zeros(m, dtype=np.bool_), np.empty(m)
    passed = 0
    for i in range(m):
        nis[i] = z[i] * z[i] / S[i, i]
        accepted[i] = nis[i] <= gate
        passed += accepted[i]
    W, of_passed, residual, told = np.empty((passed, n)), np.empty((passed, passed)), np.empty(passed), np.zeros(n)
    if passed == 0:
        return accepted, nis, S, True, np.zeros(n), told, W
    a = 0
    for i in range(m):
        if accepted[i]:
            assign(W[a], HP[i])
            residual[a] = z[i]
            b = 0
            for j in range(m):
                if accepted[j]:
                    of_passed[a, b] = S[i, j]
                    b += 1
            a += 1
    definite, error = _fold(W, of_passed, residual)
    if not definite:
        return np.zeros_like(accepted), nis, S, False, np.zeros(n), told, np.empty((0, n))
    for a in range(passed):
        for j in range(n):
            told[j] += W[a, j] * W[a, j]
    return accepted, nis, S, True, error, told, W


def weigh(P: Array, rows: Rows, gate: float) -> tuple[Correction, Array]:
    """What the rows within ``gate`` (a quantile of chi-square, 1 degree of freedom) tell, and their W, (m', n).

    ``P`` (n, n), symmetric, C-contiguous, is only read. W has no row where nothing passed or S is not definite.
    """
    if len(rows.residual) <= _FEW:
        accepted, nis, S, definite, error, told, W = _weigh_few(P, *rows, gate)
        return Correction(accepted, nis, S, definite, error, told), W
    HP, S = _project(P, rows.state, rows.partial, rows.variance)
    nis = rows.residual**2 / np.diagonal(S)
    accepted = nis <= gate
    residual = rows.residual
    nothing = np.zeros(len(P)), np.empty((0, len(P)))
    if not accepted.any():
        return Correction(accepted, nis, S, True, nothing[0], nothing[0]), nothing[1]
    of_accepted = S
    if not accepted.all():
        HP = HP[accepted]
        of_accepted = S[np.ix_(accepted, accepted)]
        residual = residual[accepted]
    # P is symmetric and row-major, LAPACK column-major: .T views are the same numbers without a copy.
    L, info = dpotrf(of_accepted.T, lower=1, clean=0)
    if info != 0:
        return Correction(np.zeros_like(accepted), nis, S, False, nothing[0], nothing[0]), nothing[1]
    WT = dtrsm(1.0, L, HP.T, side=1, lower=1, trans_a=1, overwrite_b=1)  # (n, m'): W^T = (H P)^T L^-T
    W, error = WT.T, WT @ dtrsv(L, residual, lower=1)
    return Correction(accepted, nis, S, True, error, np.einsum("mn,mn->n", W, W)), W


def reduce(P: Array, W: Array, a: Array | None = None) -> None:
    """P := M (P - W^T W) M^T in place, M = I + a e_s^T with s the heading's place; M = I without ``a`` (n,), a[s] = 0.

    M P M^T = P + a b^T + b a^T with b = P_.s + a P_ss / 2.
    """
    many = len(W) > _FEW
    if many:
        dsyrk(-1.0, W.T, beta=1.0, c=P.T, lower=1, overwrite_c=1)  # the upper triangle of P
    if a is None:
        a = b = np.zeros(len(P))
    else:
        h = P[HEADING].copy()
        if many:
            h[:HEADING] = P[:HEADING, HEADING]
        elif len(W):
            h -= W[:, HEADING] @ W
        b = h + (0.5 * h[HEADING]) * a
    if many:
        _mirror(P, a, b)
    else:
        _subtract(P, W, a, b)


def update(P: Array, rows: Rows, gate: float) -> Correction:
    """Of any covariance (n, n), symmetric, C-contiguous, in place; the caller adds ``error`` to its estimate."""
    correction, W = weigh(P, rows, gate)
    if len(W):
        reduce(P, W)
    return correction


def correct(belief: Belief, rows: Rows, gate: float) -> Correction:
    """Update ``belief`` in place by the rows within ``gate`` (a quantile of chi-square, 1 degree of freedom)."""
    correction, W = weigh(belief.P, rows, gate)
    if len(W):
        belief.add(correction.error)
        reduce(belief.P, W, swing(correction.error, belief.layout))
    return correction
