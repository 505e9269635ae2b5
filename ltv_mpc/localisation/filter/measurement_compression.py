"""Rows of few states: their innovation covariance, and fewer rows that say the same.

m rows z = H e + n, n ~ N(0, R), R diagonal, that touch s states alone tell of the error e no more than
    J = H^T R^-1 H, (s, s),   g = H^T R^-1 z
do (a sufficient statistic). With J = C C^T, C lower triangular, s rows of variance 1 have the same,
    C^-1 g = C^T e + n',   n' ~ N(0, I)
and an update by them is the update by the m rows. A ping of 120 beam cells touches 65 states.
Order   The water's nodes come first, as the first beam meets them, then what all rows touch: a node is coupled to its
        neighbours and to these alone, so C has some eleven entries a column.
Rank    J is singular: a profiler cannot tell velocity from that of all water. Where elimination leaves less than
        ``_NOTHING`` of a diagonal, nothing is told, and the row is zero.
Source  Bierman 1977, Factorization Methods for Discrete Sequential Estimation, chapters V and VI (square-root
        information).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ltv_mpc.jit import jit
from ltv_mpc.messages import Array

_NOTHING = 1e-12
_COMMON = 8
"""A state that more than one row in so many touches comes last."""


@jit
def touched_states(
    state: npt.NDArray[np.int64], partial: Array, n: int
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """The states of n that rows (m, w) touch, (s,), in the head's order; of each entry its place among them, (m, w).

    -1 where ``partial`` is zero.
    """
    m, w = state.shape
    count = np.zeros(n, dtype=np.int64)
    for i in range(m):
        for a in range(w):
            if partial[i, a] != 0.0:
                count[state[i, a]] += 1
    place, places = np.full(n, -1), np.empty(n, dtype=np.int64)
    s = 0
    for i in range(m):
        for a in range(w):
            k = state[i, a]
            if partial[i, a] != 0.0 and place[k] < 0 and _COMMON * count[k] <= m:
                place[k], places[s] = s, k
                s += 1
    for k in range(n):
        if _COMMON * count[k] > m:
            place[k], places[s] = s, k
            s += 1
    local = np.empty((m, w), dtype=np.int64)
    for i in range(m):
        for a in range(w):
            local[i, a] = place[state[i, a]] if partial[i, a] != 0.0 else -1
    return places[:s].copy(), local


@jit
def _combine(out: Array, of: npt.NDArray[np.int64], by: Array, count: int, rows: Array, first: int) -> None:
    """out_k := out_k + sum_a by_a rows[of_a]_k for k from ``first`` on, over ``count`` of a: four in one pass."""
    to = out[first:]  # slices, which begin at 0: of an index that may be negative no loop is made into vectors
    a = 0
    while a + 4 <= count:
        c0, c1, c2, c3 = by[a], by[a + 1], by[a + 2], by[a + 3]
        r0, r1, r2, r3 = rows[of[a]][first:], rows[of[a + 1]][first:], rows[of[a + 2]][first:], rows[of[a + 3]][first:]
        for k in range(len(to)):
            to[k] += (c0 * r0[k] + c1 * r1[k]) + (c2 * r2[k] + c3 * r3[k])
        a += 4
    while a < count:
        c, r = by[a], rows[of[a]][first:]
        for k in range(len(to)):
            to[k] += c * r[k]
        a += 1


class SparseRows(NamedTuple):
    """Of rows (m, w), those that are not zero: in which columns, how large, and how many in each row."""

    of: npt.NDArray[np.int64]  # (m, w)
    by: Array  # (m, w)
    counts: npt.NDArray[np.int64]  # (m,)


@jit
def sparse_rows(column: npt.NDArray[np.int64], value: Array) -> SparseRows:
    """Of ``value`` (m, w) in the columns ``column`` (m, w)."""
    m, w = value.shape
    of, by, counts = np.empty((m, w), dtype=np.int64), np.empty((m, w)), np.zeros(m, dtype=np.int64)
    for i in range(m):
        for a in range(w):
            if value[i, a] != 0.0:
                of[i, counts[i]], by[i, counts[i]] = column[i, a], value[i, a]
                counts[i] += 1
    return SparseRows(of, by, counts)


@jit
def project(H: SparseRows, P: Array) -> Array:
    """H P, (m, n), of rows that name rows of P (k, n)."""
    HP = np.zeros((len(H.counts), P.shape[1]))
    for i in range(len(HP)):
        _combine(HP[i], H.of[i], H.by[i], H.counts[i], P, 0)
    return HP


@jit
def innovation_covariance(H: SparseRows, PH: Array, variance: Array) -> Array:
    """S = H P H^T + R, (m, m), symmetric to the last bit, of P H^T (k, m)."""
    m = len(variance)
    S = np.zeros((m, m))
    for i in range(m):
        _combine(S[i], H.of[i], H.by[i], H.counts[i], PH, i)
        for j in range(i):
            S[i, j] = S[j, i]
        S[i, i] += variance[i]
    return S


@jit
def touched_innovation_covariance(
    P: Array, places: npt.NDArray[np.int64], local: npt.NDArray[np.int64], partial: Array, variance: Array
) -> Array:
    """S of rows as in ``touched_states``: of the states that they touch alone."""
    s = len(places)
    own = np.empty((s, s))
    for i in range(s):
        for j in range(s):
            own[i, j] = P[places[i], places[j]]
    H = sparse_rows(local, partial)
    return innovation_covariance(H, np.ascontiguousarray(project(H, own).T), variance)


@jit
def _root(local: npt.NDArray[np.int64], partial: Array, weight: Array, z: Array, s: int) -> tuple[Array, Array]:
    """C^T, (s, s), and C^-1 g, (s,), of rows (m, w) with ``weight`` = 1 / R; those of weight zero do not count."""
    m, w = local.shape
    J, told = np.zeros((s, s)), np.zeros(s)  # J: its upper triangle, which becomes C^T
    for i in range(m):
        if weight[i] == 0.0:
            continue
        for a in range(w):
            p = local[i, a]
            if p < 0:
                continue
            c = weight[i] * partial[i, a]
            told[p] += c * z[i]
            for b in range(w):
                q = local[i, b]
                if q >= p:
                    J[p, q] += c * partial[i, b]
    least = np.empty(s)
    for j in range(s):
        least[j] = _NOTHING * J[j, j]
    coupled = np.empty(s, dtype=np.int64)
    for j in range(s):
        if J[j, j] <= least[j]:
            J[j, j:], told[j] = 0.0, 0.0
            continue
        pivot = math.sqrt(J[j, j])
        told[j] /= pivot
        count = 0
        for k in range(j, s):
            if J[j, k] != 0.0:
                J[j, k] /= pivot
                coupled[count] = k
                count += 1
        for a in range(1, count):
            p = coupled[a]
            c = J[j, p]
            told[p] -= c * told[j]
            for b in range(a, count):
                J[p, coupled[b]] -= c * J[j, coupled[b]]
    return J, told


@jit
def compress(
    P: Array,
    places: npt.NDArray[np.int64],
    local: npt.NDArray[np.int64],
    partial: Array,
    weight: Array,
    z: Array,
) -> tuple[SparseRows, Array, Array, Array]:
    """Of the rows that say the same as (m, w) with ``weight`` = 1 / R: H, H P, (s, n), S, (s, s), and residuals, (s,).

    A row of weight zero does not count.
    """
    s = len(places)
    CT, told = _root(local, partial, weight, z, s)
    own, whole = np.empty((s, s), dtype=np.int64), np.empty((s, s), dtype=np.int64)  # columns, among s and among n
    for i in range(s):
        for k in range(s):
            own[i, k], whole[i, k] = k, places[k]
    H = sparse_rows(whole, CT)
    HP = project(H, P)
    PH = np.empty((s, s))
    for k in range(s):
        for i in range(s):
            PH[k, i] = HP[i, places[k]]
    return H, HP, innovation_covariance(sparse_rows(own, CT), PH, np.ones(s)), told
