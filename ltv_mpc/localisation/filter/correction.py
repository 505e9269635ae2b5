"""One Kalman update by the rows of one message, with an innovation gate: of a covariance, and of a belief.

S = H P H^T + R,  each row passes if residual_i^2 / S_ii <= gate;  of those that pass, with S = L L^T, W = L^-1 H P:
    error = W^T L^-1 residual,   P := P - W^T W
Doubted are rows beyond the gate up to a limit, where one is given: of measurements that come seldom, most of S is the
state's own error, and so is most of a residual that is too large. They are used with as much noise as makes them just
pass, S_ii := residual_i^2 / gate, so that none, right or wrong, moves a state by more than one that passes could
(Huber 1981, Robust statistics; Yang, He & Xu 2001, J. Geodesy 75, adaptively robust filtering).
``whiten`` says what the rows tell of the error, ``reduce_covariance`` what then is left of the covariance,
``update_covariance`` does both on any P;
 ``correct`` moves a belief by the error and carries P over to the estimate that has moved
(``invariant_correction.py``).
Exact   P stays symmetric to the last bit: of few rows both triangles are reckoned by the same sums, of many one
        triangle is, and the other written from it tile by tile.
Cost    H is sparse: H P costs m w n, S m w (s + m / 2) with s the states that H touches, W m^2 n, W^T W m n^2 / 2; then
        one pass over P. Where s is much less than m, s rows that say the same take the place of m
        (``measurement_compression.py``).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.linalg.blas import dsyrk, dtrsm, dtrsv
from scipy.linalg.lapack import dpotrf

from ltv_mpc.jit import copy_to, jit
from ltv_mpc.localisation.adaptive.failure_signatures import update_signatures
from ltv_mpc.localisation.filter.invariant_correction import HEADING, coupling_vector, heading_coupling
from ltv_mpc.localisation.filter.measurement_compression import (
    compress,
    innovation_covariance,
    project,
    sparse_rows,
    touched_innovation_covariance,
    touched_states,
)
from ltv_mpc.localisation.filter.state import Belief, apply_error
from ltv_mpc.localisation.sensors.rows import Rows
from ltv_mpc.messages import Array

_FEW = 4
"""Rows up to which no library is called: its calls would take longer than the sums, and be another pass over P."""

_MUCH_LESS = 0.75
"""Of the rows' number. Below it, making fewer of them is paid back by what is done with them."""

_TILE = 32
"""Two tiles of P, 16 kB, stay in the innermost cache while one becomes the other's transpose."""


class Correction(NamedTuple):
    """What came of each row. ``nis`` is residual^2 / S_ii, before the gate: chi-square of one degree of freedom."""

    accepted: npt.NDArray[np.bool_]
    nis: Array
    S: Array  # (m, m), of all rows
    definite: bool  # S was positive definite; if not, nothing has been touched, and P must not be trusted
    error: Array  # (n,), of the estimate: what is to be added to it; zero if no row passed
    deweighted: int  # rows that were used though they are not accepted


@jit
def _fold(HP: Array, HE: Array, S: Array, residual: Array) -> bool:
    """S = L L^T; HP := L^-1 HP = W, HE := L^-1 HE = Y and residual := L^-1 residual, in place. False and anything if S
    is not definite.
    """
    (m, n), K = HP.shape, HE.shape[1]
    L = np.zeros((m, m))
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
                return False
        for k in range(i):
            c = L[i, k]
            residual[i] -= c * residual[k]
            for j in range(n):
                HP[i, j] -= c * HP[k, j]
            for j in range(K):
                HE[i, j] -= c * HE[k, j]
        residual[i] /= L[i, i]
        for j in range(n):
            HP[i, j] /= L[i, i]
        for j in range(K):
            HE[i, j] /= L[i, i]
    return True


@jit
def _gated(S: Array, z: Array, gate: float) -> tuple[npt.NDArray[np.bool_], Array, int]:
    """Which rows pass, (m,), residual^2 / S_ii of each, (m,), and how many."""
    m = len(z)
    accepted, nis, passed = np.zeros(m, dtype=np.bool_), np.empty(m), 0
    for i in range(m):
        nis[i] = z[i] * z[i] / S[i, i]
        accepted[i] = nis[i] <= gate
        passed += accepted[i]
    return accepted, nis, passed


@jit
def _doubted(S: Array, z: Array, nis: Array, gate: float, limit: float) -> tuple[Array, int]:
    """What is added to each row's noise, (m,), and of how many."""
    more, count = np.zeros(len(z)), 0
    for i in range(len(z)):
        if gate < nis[i] <= limit:
            more[i] = z[i] * z[i] / gate - S[i, i]
            count += 1
    return more, count


@jit
def _tell(W: Array, residual: Array) -> Array:
    """The error W^T L^-1 residual, (n,), with ``residual`` = L^-1 residual."""
    m, n = W.shape
    error = np.zeros(n)
    for i in range(m):
        w, c = W[i], residual[i]
        for j in range(n):
            error[j] += c * w[j]
    return error


@jit
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


@jit
def _mirror(P: Array, a: Array, b: Array) -> None:
    """P := P + a b^T + b a^T, of which only the upper triangle is read, and both are written, tile by tile."""
    n = P.shape[0]
    for top in range(0, n, _TILE):
        bottom = min(top + _TILE, n)
        for left in range(top, n, _TILE):
            right = min(left + _TILE, n)
            for i in range(top, bottom):
                ai, bi, first = a[i], b[i], max(i, left)
                row, a_, b_ = P[i][first:right], a[first:right], b[first:right]  # vectors: of slices from 0 on
                for j in range(len(row)):
                    row[j] += ai * b_[j] + bi * a_[j]
            for j in range(left, right):
                for i in range(top, min(bottom, j)):
                    P[j, i] = P[i, j]


@jit
def _whiten_few(
    P: Array, E: Array, rows: Rows, gate: float, limit: float
) -> tuple[npt.NDArray[np.bool_], Array, Array, bool, Array, int, Array, Array, Array]:
    """The fields of a ``Correction``, and W, Y and y, of few rows: without a library's calls."""
    z, m, n = rows.residual, len(rows.residual), P.shape[0]
    H = sparse_rows(rows.state, rows.partial)
    HP, HE = project(H, P), project(H, E)
    S = innovation_covariance(H, np.ascontiguousarray(HP.T), rows.variance)
    accepted, nis, passed = _gated(S, z, gate)
    more, deweighted = _doubted(S, z, nis, gate, limit)
    passed += deweighted
    W, of_passed, residual = np.empty((passed, n)), np.empty((passed, passed)), np.empty(passed)
    Y = np.empty((passed, E.shape[1]))
    if passed == 0:
        return accepted, nis, S, True, np.zeros(n), 0, W, Y, residual
    a = 0
    for i in range(m):
        if accepted[i] or more[i] > 0.0:
            copy_to(W[a], HP[i])
            copy_to(Y[a], HE[i])
            residual[a] = z[i]
            b = 0
            for j in range(m):
                if accepted[j] or more[j] > 0.0:
                    of_passed[a, b] = S[i, j]
                    b += 1
            of_passed[a, a] += more[i]
            a += 1
    if not _fold(W, Y, of_passed, residual):
        return np.zeros_like(accepted), nis, S, False, np.zeros(n), 0, W[:0], Y[:0], residual[:0]
    error = _tell(W, residual)
    return accepted, nis, S, True, error, deweighted, W, Y, residual


class WhitenedRows(NamedTuple):
    """Rows that passed, or as many as say the same, made independent, of variance 1; none where S is not definite."""

    W: Array  # (m', n), L^-1 H P
    Y: Array  # (m', K), L^-1 H E
    y: Array  # (m',), L^-1 residual


def whiten(P: Array, E: Array, rows: Rows, gate: float) -> tuple[Correction, WhitenedRows]:
    """What the rows within ``gate`` (a quantile of chi-square, 1 degree of freedom) tell.

    ``P`` (n, n), symmetric, and ``E`` (n, K), both C-contiguous, are only read.
    """
    if len(rows.residual) <= _FEW:
        accepted, nis, S, definite, error, _, W, Y, y = _whiten_few(P, E, rows, gate, gate)
        return Correction(accepted, nis, S, definite, error, 0), WhitenedRows(W, Y, y)
    places, local = touched_states(rows.state, rows.partial, len(P))
    S = touched_innovation_covariance(P, places, local, rows.partial, rows.variance)
    z, n = rows.residual, len(P)
    nothing = WhitenedRows(np.empty((0, n)), np.empty((0, E.shape[1])), np.empty(0))
    accepted, nis, passed = _gated(S, z, gate)
    if passed == 0:
        return Correction(accepted, nis, S, True, np.zeros(n), 0), nothing
    if len(places) <= _MUCH_LESS * passed and rows.variance.min() > 0.0:
        H, HP, of_passed, z = compress(P, places, local, rows.partial, accepted / rows.variance, z)
    elif passed == len(z):
        H, of_passed = sparse_rows(rows.state, rows.partial), S
        HP = project(H, P)
    else:
        H, of_passed = sparse_rows(rows.state[accepted], rows.partial[accepted]), S[np.ix_(accepted, accepted)]
        HP, z = project(H, P), z[accepted]
    # P is symmetric and row-major, LAPACK column-major: .T views are the same numbers without a copy.
    L, info = dpotrf(of_passed.T, lower=1, clean=0)
    if info != 0:
        return Correction(np.zeros_like(accepted), nis, S, False, np.zeros(n), 0), nothing
    W = dtrsm(1.0, L, HP.T, side=1, lower=1, trans_a=1, overwrite_b=1).T  # W^T = (H P)^T L^-T
    y = dtrsv(L, z, lower=1)
    Y = nothing.Y
    if E.shape[1]:
        Y = dtrsm(1.0, L, project(H, E).T, side=1, lower=1, trans_a=1, overwrite_b=1).T
    return Correction(accepted, nis, S, True, _tell(W, y), 0), WhitenedRows(W, Y, y)


@jit
def _turn(P: Array, W: Array, a: Array) -> Array:
    """b of ``reduce_covariance``, (n,), of P - W^T W with P's upper triangle."""
    b: Array = P[HEADING].copy()
    for j in range(HEADING):
        b[j] = P[j, HEADING]
    for k in range(W.shape[0]):
        c = W[k, HEADING]
        for j in range(len(b)):
            b[j] -= c * W[k, j]
    half = 0.5 * b[HEADING]
    for j in range(len(b)):
        b[j] += half * a[j]
    return b


@jit
def _swing_too(E: Array, a: Array) -> None:
    """E := M E of ``reduce_covariance``."""
    for i in range(len(a)):
        for j in range(E.shape[1]):
            E[i, j] += a[i] * E[HEADING, j]


@jit
def _correct_few(
    x: Array,
    R: Array,
    P: Array,
    E: Array,
    score: Array,
    information: Array,
    rows: Rows,
    gate: float,
    limit: float,
    mean: int,
    north: int,
    east: int,
) -> tuple[npt.NDArray[np.bool_], Array, Array, bool, Array, int]:
    """``correct`` by few rows but for the mounting: the fields of a ``Correction``."""
    accepted, nis, S, definite, error, deweighted, W, Y, y = _whiten_few(P, E, rows, gate, limit)
    if W.shape[0]:
        apply_error(x, R, error)
        a = coupling_vector(error, mean, north, east)
        _subtract(P, W, a, _turn(P, W, a))
        if E.shape[1]:
            update_signatures(E, score, information, W, Y, y)
            _swing_too(E, a)
    return accepted, nis, S, definite, error, deweighted


def reduce_covariance(P: Array, W: Array, a: Array | None = None) -> None:
    """P := M (P - W^T W) M^T in place, M = I + a e_s^T with s the heading's place; M = I without ``a`` (n,), a[s] = 0.

    M P M^T = P + a b^T + b a^T with b = P_.s + a P_ss / 2.
    """
    many = len(W) > _FEW
    if many:
        dsyrk(-1.0, W.T, beta=1.0, c=P.T, lower=1, overwrite_c=1)  # the upper triangle of P
        W = W[:0]  # is subtracted
    if a is None:
        a = b = np.zeros(len(P))  # of a filter that may have no heading
    else:
        b = _turn(P, W, a)
    if many:
        _mirror(P, a, b)
    else:
        _subtract(P, W, a, b)


def update_covariance(P: Array, rows: Rows, gate: float) -> Correction:
    """Of any covariance (n, n), symmetric, C-contiguous, in place; the caller adds ``error`` to its estimate."""
    correction, white = whiten(P, np.empty((len(P), 0)), rows, gate)
    if len(white.W):
        reduce_covariance(P, white.W)
    return correction


def correct(belief: Belief, rows: Rows, gate: float, limit: float = 0.0) -> Correction:
    """Update ``belief`` in place by the rows within ``gate`` (a quantile of chi-square, 1 degree of freedom).

    Those between it and ``limit``, of a message of few rows, are doubted.
    """
    layout, signatures = belief.layout, belief.signatures
    E, score, information = signatures.error, signatures.score, signatures.information
    if len(rows.residual) <= _FEW:
        water = layout.mean.start, layout.north.start, layout.east.start
        correction = Correction(
            *_correct_few(belief.x, belief.R, belief.P, E, score, information, rows, gate, limit, *water)
        )
        belief.apply_mounting_error(correction.error)
        return correction
    correction, white = whiten(belief.P, E, rows, gate)
    if len(white.W):
        belief.apply_error(correction.error)
        a = heading_coupling(correction.error, layout)
        reduce_covariance(belief.P, white.W, a)
        if E.shape[1]:
            signatures.update(*white)
            _swing_too(E, a)
    return correction
