"""Measurement compression: replace m scalar measurements of s < m states by s equivalent ones.

Of m rows z = H e + n, n ~ N(0, R), R diagonal, that touch only s states,
    J = H^T R^-1 H, (s, s),   g = H^T R^-1 z
is a sufficient statistic for the error e. With J = C C^T, C lower triangular, the s rows of variance 1
    C^-1 g = C^T e + n',   n' ~ N(0, I)
have the same J and g, so they give the same update. A ping of 120 beam cells touches 65 states.
Order   Grid points of the water come first, in the order in which the first beam meets them, then the states that most
        rows touch. A grid point is coupled only to its neighbours and to these, so C has about eleven entries a column.
Rank    J is singular: an ADCP cannot separate vehicle velocity from a current common to all depths. If elimination
        leaves less than ``_RANK_TOLERANCE`` of a diagonal element, the row carries no information and becomes zero.
Shapes  rows as in ``sensors/rows.py``: state (m, w) and partial (m, w); ``states`` (s,) indices of the touched states;
        ``local`` (m, w) position of each entry among them, -1 where partial is 0.
Source  Bierman 1977, Factorization Methods for Discrete Sequential Estimation, chapters V and VI (square-root
        information filter).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ltv_mpc.jit import jit, jit_outlined
from ltv_mpc.messages import Array

_RANK_TOLERANCE = 1e-12
"""Smallest pivot relative to its diagonal element before elimination."""

_COMMON = 8
"""A state that more than one in ``_COMMON`` rows touches is ordered last."""


@jit
def touched_states(
    state: npt.NDArray[np.int64], partial: Array, n: int
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Return the states that rows touch, in elimination order.

    Parameters
    ----------
    state : (m, w) state index of each entry.
    partial : (m, w) partial derivatives; entries of value 0 touch nothing.
    n : number of states.

    Returns
    -------
    states : (s,) indices of the touched states.
    local : (m, w) position of each entry in ``states``; -1 where ``partial`` is 0.
    """
    m, w = state.shape
    count = np.zeros(n, dtype=np.int64)
    for i in range(m):
        for a in range(w):
            if partial[i, a] != 0.0:
                count[state[i, a]] += 1
    place, states = np.full(n, -1), np.empty(n, dtype=np.int64)
    s = 0
    for i in range(m):
        for a in range(w):
            k = state[i, a]
            if partial[i, a] != 0.0 and place[k] < 0 and _COMMON * count[k] <= m:
                place[k], states[s] = s, k
                s += 1
    for k in range(n):
        if _COMMON * count[k] > m:
            place[k], states[s] = s, k
            s += 1
    local = np.empty((m, w), dtype=np.int64)
    for i in range(m):
        for a in range(w):
            local[i, a] = place[state[i, a]] if partial[i, a] != 0.0 else -1
    return states[:s].copy(), local


@jit_outlined
def _combine(out: Array, columns: npt.NDArray[np.int64], values: Array, count: int, rows: Array, first: int) -> None:
    """Add a sparse combination of rows, out += sum_a values_a rows[columns_a] from ``first`` on, four at a time."""
    to = out[first:]  # slices start at index 0: a loop over an index that may be negative is not vectorised
    a = 0
    while a + 4 <= count:
        c0, c1, c2, c3 = values[a], values[a + 1], values[a + 2], values[a + 3]
        r0, r1, r2, r3 = (
            rows[columns[a]][first:],
            rows[columns[a + 1]][first:],
            rows[columns[a + 2]][first:],
            rows[columns[a + 3]][first:],
        )
        for k in range(len(to)):
            to[k] += (c0 * r0[k] + c1 * r1[k]) + (c2 * r2[k] + c3 * r3[k])
        a += 4
    while a < count:
        c, r = values[a], rows[columns[a]][first:]
        for k in range(len(to)):
            to[k] += c * r[k]
        a += 1


class SparseRows(NamedTuple):
    """Non-zero entries of m rows: column and value of each, packed to the left, and their number in each row."""

    columns: npt.NDArray[np.int64]  # (m, w)
    values: Array  # (m, w)
    counts: npt.NDArray[np.int64]  # (m,)


@jit_outlined
def sparse_rows(column: npt.NDArray[np.int64], value: Array) -> SparseRows:
    """Pack the non-zero entries of rows.

    Parameters
    ----------
    column : (m, w) column of each entry.
    value : (m, w) value of each entry.
    """
    m, w = value.shape
    columns, values, counts = np.empty((m, w), dtype=np.int64), np.empty((m, w)), np.zeros(m, dtype=np.int64)
    for i in range(m):
        for a in range(w):
            if value[i, a] != 0.0:
                columns[i, counts[i]], values[i, counts[i]] = column[i, a], value[i, a]
                counts[i] += 1
    return SparseRows(columns, values, counts)


@jit_outlined
def project(H: SparseRows, P: Array) -> Array:
    """Return the product H P, (m, n).

    Parameters
    ----------
    H : m sparse rows whose columns are rows of P.
    P : (k, n) matrix.
    """
    HP = np.zeros((len(H.counts), P.shape[1]))
    for i in range(len(HP)):
        _combine(HP[i], H.columns[i], H.values[i], H.counts[i], P, 0)
    return HP


@jit_outlined
def innovation_covariance(H: SparseRows, PH: Array, variance: Array) -> Array:
    """Return the innovation covariance S = H P H^T + R, (m, m), bitwise symmetric.

    Parameters
    ----------
    H : m sparse rows.
    PH : (k, m) product P H^T.
    variance : (m,) diagonal of R.
    """
    m = len(variance)
    S = np.zeros((m, m))
    for i in range(m):
        _combine(S[i], H.columns[i], H.values[i], H.counts[i], PH, i)
        for j in range(i):
            S[i, j] = S[j, i]
        S[i, i] += variance[i]
    return S


@jit
def touched_innovation_covariance(
    P: Array, states: npt.NDArray[np.int64], local: npt.NDArray[np.int64], partial: Array, variance: Array
) -> Array:
    """Return the innovation covariance S, (m, m), from the touched states alone.

    Parameters
    ----------
    P : (n, n) covariance.
    states : (s,) indices of the touched states.
    local : (m, w) as ``touched_states`` returns it.
    partial : (m, w) partial derivatives.
    variance : (m,) diagonal of R.
    """
    s = len(states)
    own = np.empty((s, s))
    for i in range(s):
        for j in range(s):
            own[i, j] = P[states[i], states[j]]
    H = sparse_rows(local, partial)
    return innovation_covariance(H, np.ascontiguousarray(project(H, own).T), variance)


@jit
def _root(local: npt.NDArray[np.int64], partial: Array, weight: Array, z: Array, s: int) -> tuple[Array, Array]:
    """Return C^T, (s, s), and C^-1 g, (s,), for rows with ``weight`` = 1 / R; rows of weight 0 are left out."""
    m, w = local.shape
    J, g = np.zeros((s, s)), np.zeros(s)  # the upper triangle of J becomes C^T, g becomes C^-1 g
    for i in range(m):
        if weight[i] == 0.0:
            continue
        for a in range(w):
            p = local[i, a]
            if p < 0:
                continue
            c = weight[i] * partial[i, a]
            g[p] += c * z[i]
            for b in range(w):
                q = local[i, b]
                if q >= p:
                    J[p, q] += c * partial[i, b]
    smallest = np.empty(s)
    for j in range(s):
        smallest[j] = _RANK_TOLERANCE * J[j, j]
    coupled = np.empty(s, dtype=np.int64)
    for j in range(s):
        if J[j, j] <= smallest[j]:
            J[j, j:], g[j] = 0.0, 0.0
            continue
        pivot = math.sqrt(J[j, j])
        g[j] /= pivot
        count = 0
        for k in range(j, s):
            if J[j, k] != 0.0:
                J[j, k] /= pivot
                coupled[count] = k
                count += 1
        for a in range(1, count):
            p = coupled[a]
            c = J[j, p]
            g[p] -= c * g[j]
            for b in range(a, count):
                J[p, coupled[b]] -= c * J[j, coupled[b]]
    return J, g


@jit
def compress(
    P: Array,
    states: npt.NDArray[np.int64],
    local: npt.NDArray[np.int64],
    partial: Array,
    weight: Array,
    z: Array,
) -> tuple[SparseRows, Array, Array, Array]:
    """Compress m rows into s equivalent rows of variance 1.

    Parameters
    ----------
    P : (n, n) covariance.
    states : (s,) indices of the touched states.
    local : (m, w) as ``touched_states`` returns it.
    partial : (m, w) partial derivatives.
    weight : (m,) 1 / R of each row; 0 leaves a row out.
    z : (m,) residuals.

    Returns
    -------
    H : s sparse rows.
    HP : (s, n) product H P.
    S : (s, s) innovation covariance.
    residual : (s,) equivalent residuals.
    """
    s = len(states)
    CT, g = _root(local, partial, weight, z, s)
    own, whole = (
        np.empty((s, s), dtype=np.int64),
        np.empty((s, s), dtype=np.int64),
    )  # among touched, among all
    for i in range(s):
        for k in range(s):
            own[i, k], whole[i, k] = k, states[k]
    H = sparse_rows(whole, CT)
    HP = project(H, P)
    PH = np.empty((s, s))
    for k in range(s):
        for i in range(s):
            PH[k, i] = HP[i, states[k]]
    return H, HP, innovation_covariance(sparse_rows(own, CT), PH, np.ones(s)), g
