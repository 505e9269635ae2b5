"""Riccati sweeps: the solution of a problem whose rows are replaced by quadratic terms.

    minimise   the problem's cost (ocp/problem.py)  +  sum over rows   1/2 weight g^2 + linear g,    g_k = G_k z_k
    subject to x_0 = 0,   x_(k+1) = F_k z_k + f_k

A method that treats limits (riccati.py) turns them into these terms. With the cost to go  1/2 x' P x + v' x  a backward
sweep gives, from the last stage to the first,

    M = H_k + G_k' weight G_k + F_k' P F_k,    w = h_k + G_k' linear + F_k' (v + P f_k)
    u = K x + kappa,    [K, kappa] = -M_uu^-1 [M_ux, w_u]
    P <- M_xx + M_xu K,    v <- w_x + M_xu kappa

and a forward sweep the states and inputs (Rao, Wright & Rawlings 1998).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ltv_mpc.control.ocp.problem import Problem, row_values
from ltv_mpc.jit import jit, jit_outlined
from ltv_mpc.messages import Array


class Sweep(NamedTuple):
    """Workspace of the sweeps of problems of one size."""

    weight: Array  # (N+1, M) input of a sweep
    linear: Array  # (N+1, M) input of a sweep
    g: Array  # (N+1, M) result of the last sweep: values of the rows
    z: Array  # (N+1, n+m) its states and inputs
    law: Array  # (N, m, n+1) K and kappa
    P: Array  # (n, n)
    v: Array  # (n,)
    PF: Array  # (n, n+m)
    FPF: Array  # (n+m, n+m)
    M: Array  # (n+m, n+m)
    w: Array  # (n+m,)

    @classmethod
    def empty(cls, p: Problem) -> Sweep:
        """Return a workspace for problems of the size of one.

        Parameters
        ----------
        p : problem.
        """
        N, n, m, M = p.sizes
        rows, z = np.zeros((N + 1, M)), n + m
        return cls(
            rows, rows.copy(), rows.copy(), np.zeros((N + 1, z)), np.zeros((N, m, n + 1)),
            np.zeros((n, n)), np.zeros(n), np.zeros((n, z)), np.zeros((z, z)), np.zeros((z, z)), np.zeros(z),
        )  # fmt: skip


@jit_outlined
def sweep(p: Problem, work: Sweep) -> bool:
    """Find the states and inputs of least cost, by one backward and one forward sweep.

    Parameters
    ----------
    p : problem.
    work : its weight and linear are given; the rest is overwritten.

    Returns
    -------
    False if the cost has no minimum, or the result is not finite.
    """
    N, n = p.f.shape
    for k in range(N, -1, -1):
        _add_rows(p, work, k)
        if k < N:
            _add_next(p, work, k)
            if not _find_law(work, k, n):
                return False
        if k > 0:
            _find_cost_to_go(work, k, N, n)
    z = work.z
    for i in range(n):
        z[0, i] = 0.0
    for k in range(N):
        for a in range(z.shape[1] - n):
            u = work.law[k, a, n]
            for j in range(n):
                u += work.law[k, a, j] * z[k, j]
            z[k, n + a] = u
        for i in range(n):
            x = p.f[k, i]
            for j in range(z.shape[1]):
                x += p.F[k, i, j] * z[k, j]
            z[k + 1, i] = x
    row_values(p, z, work.g)
    return bool(np.isfinite(np.sum(z[N - 1])))


@jit
def _add_rows(p: Problem, work: Sweep, k: int) -> None:
    """Set M and w to the cost of a stage and the terms of its rows."""
    M, w = work.M, work.w
    for i in range(len(w)):
        w[i] = p.h[k, i]
        for j in range(len(w)):
            M[i, j] = p.H[k, i, j]
    for row in range(p.G.shape[1]):
        weight, linear = work.weight[k, row], work.linear[k, row]
        if weight == 0.0 and linear == 0.0:
            continue
        for i in range(len(w)):
            a = p.G[k, row, i]
            if a != 0.0:
                w[i] += linear * a
                for j in range(len(w)):
                    M[i, j] += weight * a * p.G[k, row, j]


@jit
def _add_next(p: Problem, work: Sweep, k: int) -> None:
    """Add the cost to go from the next state to M and w."""
    P, v, M, w, F = work.P, work.v, work.M, work.w, p.F[k]
    for j in range(len(v)):
        gap = p.f[k, j]
        if gap != 0.0:  # a solution of the equations of motion has none
            for i in range(len(v)):
                v[i] += P[i, j] * gap
    for i in range(len(v)):
        for j in range(len(w)):
            w[j] += F[i, j] * v[i]
    np.dot(P, F, work.PF)  # BLAS: a third of the time of loops
    np.dot(F.T, work.PF, work.FPF)
    for i in range(len(w)):
        for j in range(len(w)):
            M[i, j] += work.FPF[i, j]


@jit
def _find_law(work: Sweep, k: int, n: int) -> bool:
    """Compute the law of a stage by a Cholesky factorisation of M_uu; False if that is not positive definite."""
    M, w, law = work.M, work.w, work.law[k]
    m = law.shape[0]
    for i in range(m):  # M_uu = L L', with L in its own place
        for j in range(i + 1):
            s = M[n + i, n + j]
            for a in range(j):
                s -= M[n + i, n + a] * M[n + j, n + a]
            if i > j:
                M[n + i, n + j] = s / M[n + j, n + j]
            elif s > 0.0:
                M[n + i, n + i] = math.sqrt(s)
            else:
                return False
    for i in range(m):
        law[i, n] = -w[n + i]
        for j in range(n):
            law[i, j] = -M[n + i, j]
        for a in range(i):
            for j in range(n + 1):
                law[i, j] -= M[n + i, n + a] * law[a, j]
        for j in range(n + 1):
            law[i, j] /= M[n + i, n + i]
    for i in range(m - 1, -1, -1):
        for a in range(i + 1, m):
            for j in range(n + 1):
                law[i, j] -= M[n + a, n + i] * law[a, j]
        for j in range(n + 1):
            law[i, j] /= M[n + i, n + i]
    return True


@jit
def _find_cost_to_go(work: Sweep, k: int, N: int, n: int) -> None:
    """Compute P and v of a stage from M and w, and its law."""
    for i in range(n):
        work.v[i] = work.w[i]
        for j in range(n):
            work.P[i, j] = work.M[i, j]
        if k < N:
            for a in range(work.law.shape[1]):
                factor = work.M[i, n + a]
                work.v[i] += factor * work.law[k, a, n]
                for j in range(n):
                    work.P[i, j] += factor * work.law[k, a, j]
    for i in range(n):  # rounding makes it unsymmetric, and the recursion would let that grow
        for j in range(i):
            work.P[i, j] = work.P[j, i] = 0.5 * (work.P[i, j] + work.P[j, i])
