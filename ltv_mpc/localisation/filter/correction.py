"""Measurement update of a Kalman filter with innovation gate and robust de-weighting.

With rows z = H e + n, n ~ N(0, R), R diagonal, S = H P H^T + R; a row passes the gate if z_i^2 / S_ii <= gate.
Of the rows that pass, S = L L^T and the whitened rows are W = L^-1 H P, y = L^-1 z:
    e = W^T y,   P := P - W^T W
De-weighted rows are those with gate < z_i^2 / S_ii <= deweight_limit, for sensors that measure seldom. Most of their S
is the error of the state, and so is most of a residual that is too large. Their noise is inflated until they just pass,
S_ii := z_i^2 / gate. This bounds their influence: a de-weighted row, correct or not, moves no state further than a row
at the gate does (Huber 1981, Robust statistics; Yang, He & Xu 2001, J. Geodesy 75, adaptively robust filtering).
Steps   ``whiten`` gates and whitens the rows, ``reduce_covariance`` subtracts their information from P,
        ``update_covariance`` does both for any P. ``correct`` updates a whole ``Belief`` and applies the invariant
        correction (``invariant_correction.py``).
Exact   P stays bitwise symmetric: for few rows both triangles are computed by the same sums; for many rows one triangle
        is computed and copied tile by tile.
Cost    H is sparse: H P costs m w n; S costs m w (s + m / 2), s the number of states that H touches; W costs m^2 n;
        W^T W costs m n^2 / 2; then one pass over P. If s is much less than m, s equivalent rows replace the m rows
        (``measurement_compression.py``).
Shapes  P (n, n) symmetric and C-contiguous; E (n, K) mean errors of K fault hypotheses, with score (K,) and
        information (K, K) (``adaptive/failure_signatures.py``); W (m', n), Y (m', K), y (m',) for m' rows used.
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
from ltv_mpc.localisation.sensors.rows import Indices, Rows
from ltv_mpc.messages import Array

_FEW = 4
"""Largest number of rows without library calls: these would take longer than the sums and pass over P once more."""

_COMPRESSION_RATIO = 0.75
"""Largest ratio of touched states to rows at which compressing the rows costs less than it saves."""

_TILE = 32
"""Rows and columns of a tile. Two tiles of P, 16 kB, fit into the level-1 cache while one is transposed."""


class Correction(NamedTuple):
    """Result of a measurement update, row by row.

    ``nis`` is z_i^2 / S_ii before the gate: chi-square distributed with one degree of freedom.
    """

    accepted: npt.NDArray[np.bool_]  # (m,) rows that passed the gate
    nis: Array  # (m,)
    S: Array  # (m, m), of all rows
    definite: bool  # S was positive definite; if not, nothing has changed, and P must not be trusted
    error: Array  # (n,), estimated error, to be added to the estimate; zero if no row passed
    deweighted: int  # number of rows that were used with inflated noise; they do not count as accepted


class WhitenedRows(NamedTuple):
    """Rows in use, or as many equivalent ones, with independent noise of variance 1; no rows if S is not definite."""

    W: Array  # (m', n), L^-1 H P
    Y: Array  # (m', K), L^-1 H E
    y: Array  # (m',), L^-1 z


@jit
def _factor_and_whiten(S: Array, HP: Array, HE: Array, residual: Array) -> bool:
    """Factor S = L L^T and apply L^-1 in place: HP := L^-1 HP = W, HE := L^-1 HE = Y, residual := L^-1 residual = y.

    Return False, with undefined content, if S is not positive definite.
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
def _gate(S: Array, z: Array, gate: float) -> tuple[npt.NDArray[np.bool_], Array, int]:
    """Return which rows pass (m,), z_i^2 / S_ii of each (m,), and the number of rows that pass."""
    m = len(z)
    accepted, nis, passed = np.zeros(m, dtype=np.bool_), np.empty(m), 0
    for i in range(m):
        nis[i] = z[i] * z[i] / S[i, i]
        accepted[i] = nis[i] <= gate
        passed += accepted[i]
    return accepted, nis, passed


@jit
def _inflation(S: Array, z: Array, nis: Array, gate: float, deweight_limit: float) -> tuple[Array, int]:
    """Return the variance to add to each row (m,) so that it just passes, and the number of de-weighted rows."""
    more, count = np.zeros(len(z)), 0
    for i in range(len(z)):
        if gate < nis[i] <= deweight_limit:
            more[i] = z[i] * z[i] / gate - S[i, i]
            count += 1
    return more, count


@jit
def _estimated_error(W: Array, y: Array) -> Array:
    """Return the estimated error W^T y, (n,)."""
    m, n = W.shape
    error = np.zeros(n)
    for i in range(m):
        w, c = W[i], y[i]
        for j in range(n):
            error[j] += c * w[j]
    return error


@jit
def _subtract(P: Array, W: Array, a: Array, b: Array) -> None:
    """Update all of P := P - W^T W + a b^T + b a^T. Mirror elements use the same sums, so P stays symmetric."""
    n, m = P.shape[0], W.shape[0]
    for i in range(n):
        ai, bi = a[i], b[i]
        if m == 1:  # the most frequent case: one loop instead of two
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
    """Update P := P + a b^T + b a^T from its upper triangle and write both triangles, tile by tile."""
    n = P.shape[0]
    for top in range(0, n, _TILE):
        bottom = min(top + _TILE, n)
        for left in range(top, n, _TILE):
            right = min(left + _TILE, n)
            for i in range(top, bottom):
                ai, bi, first = a[i], b[i], max(i, left)
                row, a_, b_ = P[i][first:right], a[first:right], b[first:right]  # slices from 0 on vectorise
                for j in range(len(row)):
                    row[j] += ai * b_[j] + bi * a_[j]
            for j in range(left, right):
                for i in range(top, min(bottom, j)):
                    P[j, i] = P[i, j]


@jit
def _whiten_few(P: Array, E: Array, rows: Rows, gate: float, deweight_limit: float) -> tuple[Correction, WhitenedRows]:
    """Gate and whiten at most ``_FEW`` rows without library calls.

    Rows beyond the gate are de-weighted if their squared innovation is at most ``deweight_limit``; all others are
    rejected.
    """
    z, m, n = rows.residual, len(rows.residual), P.shape[0]
    H = sparse_rows(rows.state, rows.partial)
    HP, HE = project(H, P), project(H, E)
    S = innovation_covariance(H, np.ascontiguousarray(HP.T), rows.variance)
    accepted, nis, passed = _gate(S, z, gate)
    more, deweighted = _inflation(S, z, nis, gate, deweight_limit)
    passed += deweighted
    W, of_passed, y = np.empty((passed, n)), np.empty((passed, passed)), np.empty(passed)
    Y = np.empty((passed, E.shape[1]))
    a = 0
    for i in range(m):
        if accepted[i] or more[i] > 0.0:
            copy_to(W[a], HP[i])
            copy_to(Y[a], HE[i])
            y[a] = z[i]
            b = 0
            for j in range(m):
                if accepted[j] or more[j] > 0.0:
                    of_passed[a, b] = S[i, j]
                    b += 1
            of_passed[a, a] += more[i]
            a += 1
    definite = _factor_and_whiten(of_passed, W, Y, y)
    if not definite:
        accepted, deweighted = np.zeros_like(accepted), 0
        W, Y, y = np.empty((0, n)), np.empty((0, E.shape[1])), np.empty(0)
    return Correction(accepted, nis, S, definite, _estimated_error(W, y), deweighted), WhitenedRows(W, Y, y)


def whiten(P: Array, E: Array, rows: Rows, gate: float) -> tuple[Correction, WhitenedRows]:
    """Gate the rows and whiten those that pass. Nothing changes in place.

    Parameters
    ----------
    P : (n, n) covariance.
    E : (n, K) mean errors of K fault hypotheses.
    rows : m scalar measurements.
    gate : quantile of the chi-square distribution with one degree of freedom.

    Returns
    -------
    Result by row, and the whitened rows.
    """
    if len(rows.residual) <= _FEW:
        return _whiten_few(P, E, rows, gate, gate)
    states, local = touched_states(rows.state, rows.partial, len(P))
    S = touched_innovation_covariance(P, states, local, rows.partial, rows.variance)
    z, n = rows.residual, len(P)
    nothing = WhitenedRows(np.empty((0, n)), np.empty((0, E.shape[1])), np.empty(0))
    accepted, nis, passed = _gate(S, z, gate)
    if passed == 0:
        return Correction(accepted, nis, S, True, np.zeros(n), 0), nothing
    if len(states) <= _COMPRESSION_RATIO * passed and rows.variance.min() > 0.0:
        H, HP, of_passed, z = compress(P, states, local, rows.partial, accepted / rows.variance, z)
    elif passed == len(z):
        H, of_passed = sparse_rows(rows.state, rows.partial), S
        HP = project(H, P)
    else:
        H, of_passed = sparse_rows(rows.state[accepted], rows.partial[accepted]), S[np.ix_(accepted, accepted)]
        HP, z = project(H, P), z[accepted]
    # P is symmetric and row-major, LAPACK is column-major: .T is a view of the same numbers.
    L, info = dpotrf(of_passed.T, lower=1, clean=0)
    if info != 0:
        return Correction(np.zeros_like(accepted), nis, S, False, np.zeros(n), 0), nothing
    W = dtrsm(1.0, L, HP.T, side=1, lower=1, trans_a=1, overwrite_b=1).T  # W^T = (H P)^T L^-T
    y = dtrsv(L, z, lower=1)
    Y = nothing.Y
    if E.shape[1]:
        Y = dtrsm(1.0, L, project(H, E).T, side=1, lower=1, trans_a=1, overwrite_b=1).T
    return Correction(accepted, nis, S, True, _estimated_error(W, y), 0), WhitenedRows(W, Y, y)


@jit
def _heading_column(P: Array, W: Array, a: Array) -> Array:
    """Return b of ``reduce_covariance``, (n,), from P - W^T W; only the upper triangle of P is read."""
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
def _couple_signatures(E: Array, a: Array) -> None:
    """Apply the invariant correction to mean errors, E := M E with M of ``reduce_covariance``."""
    for i in range(len(a)):
        for j in range(E.shape[1]):
            E[i, j] += a[i] * E[HEADING, j]


@jit
def _correct_few(
    estimate: tuple[Array, Array, Array],
    signatures: tuple[Array, Array, Array],
    rows: tuple[Indices, Array, Array, Array],
    gate: float,
    deweight_limit: float,
    current: tuple[int, int, int],
) -> tuple[npt.NDArray[np.bool_], Array, Array, bool, Array, int]:
    """Update the estimate, except the mounting, by at most ``_FEW`` rows, as ``correct`` does.

    Named tuples would make a call take a third longer (docs/notes/kernel-arguments.md).

    Parameters
    ----------
    estimate : x (n,), R (3, 3), P (n, n) of the belief; change.
    signatures : errors (n, K), score (K,), information (K, K) of the fault hypotheses; change.
    rows : fields of ``Rows``.
    gate, deweight_limit : as in ``correct``.
    current : first indices of the current in the state: mean, north, east.

    Returns
    -------
    Fields of ``Correction``.
    """
    x, R, P = estimate
    E, score, information = signatures
    mean, north, east = current
    correction, white = _whiten_few(P, E, Rows(*rows), gate, deweight_limit)
    if white.W.shape[0]:
        apply_error(x, R, correction.error)
        a = coupling_vector(correction.error, mean, north, east)
        _subtract(P, white.W, a, _heading_column(P, white.W, a))
        if E.shape[1]:
            update_signatures(E, score, information, white.W, white.Y, white.y)
            _couple_signatures(E, a)
    return (
        correction.accepted,
        correction.nis,
        correction.S,
        correction.definite,
        correction.error,
        correction.deweighted,
    )


def reduce_covariance(P: Array, W: Array, a: Array | None = None) -> None:
    """Update P := M (P - W^T W) M^T in place, with M = I + a e_s^T and s the index of the heading error.

    With b = P_.s + a P_ss / 2:  M P M^T = P + a b^T + b a^T.

    Parameters
    ----------
    P : (n, n) covariance; changes.
    W : (m', n) whitened rows.
    a : (n,) coupling vector of ``invariant_correction.py`` with a[s] = 0; None: M = I.
    """
    many = len(W) > _FEW
    if many:
        dsyrk(-1.0, W.T, beta=1.0, c=P.T, lower=1, overwrite_c=1)  # writes the upper triangle of P
        W = W[:0]
    if a is None:
        a = b = np.zeros(len(P))  # a filter without heading
    else:
        b = _heading_column(P, W, a)
    if many:
        _mirror(P, a, b)
    else:
        _subtract(P, W, a, b)


def update_covariance(P: Array, rows: Rows, gate: float) -> Correction:
    """Update any covariance by the rows within the gate, in place. The caller adds ``error`` to its estimate.

    Parameters
    ----------
    P : (n, n) covariance, symmetric, C-contiguous; changes.
    rows : m scalar measurements.
    gate : quantile of the chi-square distribution with one degree of freedom.

    Returns
    -------
    Result by row, with the estimated error.
    """
    correction, white = whiten(P, np.empty((len(P), 0)), rows, gate)
    if len(white.W):
        reduce_covariance(P, white.W)
    return correction


def correct(belief: Belief, rows: Rows, gate: float, deweight_limit: float = 0.0) -> Correction:
    """Update a belief in place by the rows in use: estimate, covariance and fault hypotheses.

    A row is in use if it is within the gate, or if it is de-weighted.

    Parameters
    ----------
    belief : state estimate; changes.
    rows : m scalar measurements at the time of the belief.
    gate : quantile of the chi-square distribution with one degree of freedom.
    deweight_limit : rows with gate < z_i^2 / S_ii <= deweight_limit are de-weighted; no effect on more than 4 rows.

    Returns
    -------
    Result by row.
    """
    layout, signatures = belief.layout, belief.signatures
    E = signatures.error
    if len(rows.residual) <= _FEW:
        correction = Correction(
            *_correct_few(
                (belief.x, belief.R, belief.P),
                (E, signatures.score, signatures.information),
                (*rows,),
                gate,
                deweight_limit,
                (layout.mean.start, layout.north.start, layout.east.start),
            )
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
            _couple_signatures(E, a)
    return correction
