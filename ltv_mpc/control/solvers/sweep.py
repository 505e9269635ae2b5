"""Riccati sweeps: the solution of a problem whose rows are replaced by quadratic terms.

    minimise   the problem's cost (ocp/problem.py)  +  sum over rows   1/2 weight g^2 + linear g,    g_k = G_k z_k
    subject to x_0 = 0,   x_(k+1) = F_k z_k + f_k

A method that treats limits (riccati.py) turns them into these terms. With the cost to go  1/2 x' P x + v' x  a backward
sweep gives, from the last stage to the first,

    M = H_k + G_k' weight G_k + F_k' P F_k,    w = h_k + G_k' linear + F_k' (v + P f_k)
    L L' = M_uu,    [Y, y] = L^-1 [M_ux, w_u]
    P <- M_xx - Y' Y,    v <- w_x - Y' y

and a forward sweep the inputs u = -L'^-1 (Y x + y) and the states (Rao, Wright & Rawlings 1998).

Each direction is one function, and its arrays have names of their own: an argument or a field of a tuple costs
reference counting (``ltv_mpc/jit.py``), which doubles the time here. The inner loops run along rows, so that the
compiler vectorises them.
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
    law: Array  # (N, m, n+1+m) Y, y and L of each stage
    P: Array  # (n, n) cost to go of a stage
    v: Array  # (n,)
    PF: Array  # (n, n+m)
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
            rows, rows.copy(), rows.copy(), np.zeros((N + 1, z)), np.zeros((N, m, n + 1 + m)),
            np.zeros((n, n)), np.zeros(n), np.zeros((n, z)), np.zeros((z, z)), np.zeros(z),
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
    if not _backward(p, work):
        return False
    z, law, F, f, n = work.z, work.law, p.F, p.f, p.f.shape[1]
    m = z.shape[1] - n
    for i in range(n):
        z[0, i] = 0.0
    for k in range(len(F)):
        for a in range(m - 1, -1, -1):
            u = law[k, a, n]
            for j in range(n):
                u += law[k, a, j] * z[k, j]
            for b in range(a + 1, m):
                u += law[k, b, n + 1 + a] * z[k, n + b]
            z[k, n + a] = -u / law[k, a, n + 1 + a]
        for i in range(n):
            x = f[k, i]
            for j in range(n + m):
                x += F[k, i, j] * z[k, j]
            z[k + 1, i] = x
    row_values(p, z, work.g)
    return bool(np.isfinite(np.sum(z[len(F) - 1])))


@jit
def _backward(p: Problem, work: Sweep) -> bool:
    """Compute the law of all stages, from the last to the first; return False if the cost has no minimum."""
    F, f, H, h, G, weight, linear = p.F, p.f, p.H, p.h, p.G, work.weight, work.linear
    P, v, PF, M, w, laws = work.P, work.v, work.PF, work.M, work.w, work.law
    (N, n), size, m = f.shape, len(w), 0
    for k in range(N, -1, -1):
        law = laws[min(k, N - 1)]
        for j in range(size):
            w[j] = h[k, j]
        if k < N:
            m, gap = size - n, f[k].any()  # a solution of the equations of motion has no gap
            for i in range(n):
                s = v[i] + (np.dot(P[i], f[k]) if gap else 0.0)
                for j in range(size):
                    w[j] += s * F[k, i, j]
            np.dot(P, F[k], PF)  # BLAS: a third of the time of loops
            np.dot(F[k].T, PF, M)
        for i in range(M.size):
            M.flat[i] = H.flat[k * M.size + i] + (M.flat[i] if k < N else 0.0)
        for row in range(G.shape[1]):
            if weight[k, row] != 0.0 or linear[k, row] != 0.0:
                for i in range(size):
                    a = G[k, row, i]
                    if a != 0.0:
                        w[i] += linear[k, row] * a
                        a *= weight[k, row]
                        for j in range(size):
                            M[i, j] += a * G[k, row, j]
        for i in range(m):  # row i of L and of [Y, y]
            for j in range(n):
                law[i, j] = M[n + i, j]
            law[i, n] = w[n + i]
            for j in range(i):
                s = M[n + i, n + j]
                for a in range(j):
                    s -= law[i, n + 1 + a] * law[j, n + 1 + a]
                s /= law[j, n + 1 + j]
                law[i, n + 1 + j] = s
                M[n + i, n + i] -= s * s
                for a in range(n + 1):
                    law[i, a] -= s * law[j, a]
            if not M[n + i, n + i] > 0.0:
                return False
            law[i, n + 1 + i] = math.sqrt(M[n + i, n + i])
            s = 1.0 / law[i, n + 1 + i]
            for j in range(n + 1):
                law[i, j] *= s
        for i in range(n):
            v[i] = w[i]
            for j in range(n):
                P[i, j] = M[i, j]
            for a in range(m):
                s = law[a, i]
                v[i] -= s * law[a, n]
                for j in range(n):
                    P[i, j] -= s * law[a, j]
            for j in range(i):  # rounding makes it unsymmetric, and the recursion would let that grow
                P[i, j] = P[j, i]
    return True
