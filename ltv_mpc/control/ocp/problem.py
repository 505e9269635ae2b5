"""Optimal control problem of one cycle, stage by stage, as the solvers take it.

With the state x_k and the input u_k in one vector  z_k = [x_k, u_k],  k = 0 .. N  (there is no input u_N):

    minimise   sum over k of  1/2 z_k' H_k z_k + h_k' z_k + penalty_k' e_k
    subject to x_0 = 0,   x_(k+1) = F_k z_k + f_k
               low_k - e_k <= G_k z_k <= high_k + e_k,   e_k >= 0,   e_k = 0 where the penalty is infinite

F = [A, B], H = [Q, S'; S, R], h = [q, r] and G = [C, D] of the textbook (Rawlings, Mayne & Diehl 2017, section 8.8). A
row with two infinite bounds is none. A penalty that is larger than the dual that the hard limit would have is exact:
the row is then exceeded only where it cannot be kept (Fletcher 1987, section 12.3; Kerrigan & Maciejowski 2000).

All is without unit; ``assembly.py`` has the scales of x and u.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ltv_mpc.jit import jit, jit_outlined
from ltv_mpc.messages import Array


class Problem(NamedTuple):
    """Problem of N stages, with n states, m inputs and M rows of limits a stage."""

    F: Array  # (N, n, n+m) derivative of the next state
    f: Array  # (N, n) next state at z = 0
    H: Array  # (N+1, n+m, n+m) Hessian of the cost, symmetric, positive semidefinite
    h: Array  # (N+1, n+m) its gradient at z = 0
    G: Array  # (N+1, M, n+m) rows of the limits
    low: Array  # (N+1, M) lower bounds, -inf where there is none
    high: Array  # (N+1, M) upper bounds, inf where there is none
    penalty: Array  # (N+1, M) cost of an excess that is 1; inf: the row is hard

    @classmethod
    def empty(cls, N: int, n: int, m: int, M: int) -> Problem:
        """Return a problem without dynamics, cost and limits.

        Parameters
        ----------
        N, n, m, M : sizes, as in ``Problem``.
        """
        z, bound = n + m, np.full((N + 1, M), np.inf)
        return cls(
            np.zeros((N, n, z)), np.zeros((N, n)), np.zeros((N + 1, z, z)), np.zeros((N + 1, z)),
            np.zeros((N + 1, M, z)), -bound, bound.copy(), bound.copy(),
        )  # fmt: skip

    @property
    def sizes(self) -> tuple[int, int, int, int]:
        """N, n, m and M."""
        N, n, z = self.F.shape
        return N, n, z - n, self.G.shape[1]


def is_finite(p: Problem) -> bool:
    """Return True if all numbers are finite; bounds and penalties may be infinite.

    Parameters
    ----------
    p : problem.
    """
    return all(np.isfinite(part).all() for part in p[:5]) and not any(np.isnan(part).any() for part in p[5:])


@jit
def roll_out(p: Problem, z: Array) -> None:
    """Compute the states that inputs lead to.

    Parameters
    ----------
    p : problem.
    z : (N+1, n+m) has the inputs; its states are overwritten, and so is the input at N, with zero.
    """
    N, n = p.f.shape
    z[0, :n] = 0.0
    z[N, n:] = 0.0
    for k in range(N):
        for i in range(n):
            x = p.f[k, i]
            for j in range(z.shape[1]):
                x += p.F[k, i, j] * z[k, j]
            z[k + 1, i] = x


@jit
def row_values(p: Problem, z: Array, g: Array) -> None:
    """Compute the values of all rows of limits.

    Parameters
    ----------
    p : problem.
    z : (N+1, n+m) states and inputs.
    g : (N+1, M) is overwritten with G_k z_k.
    """
    for k in range(g.shape[0]):
        for i in range(g.shape[1]):
            value = 0.0
            for j in range(z.shape[1]):
                value += p.G[k, i, j] * z[k, j]
            g[k, i] = value


@jit
def costates(p: Problem, z: Array, y: Array, costate: Array) -> float:
    """Compute the duals of the dynamics by an adjoint sweep, and how far the inputs are from stationary.

    costate_k = gradient of cost and rows in x_k + A_k' costate_(k+1)

    Parameters
    ----------
    p : problem.
    z : (N+1, n+m) states and inputs.
    y : (N+1, M) duals of the rows, positive at the upper bound.
    costate : (N+1, n) is overwritten.

    Returns
    -------
    Largest entry of the gradient in the inputs; NaN if a number is not one.
    """
    N, n = p.f.shape
    worst, total = 0.0, 0.0
    gradient = np.empty(z.shape[1])
    for k in range(N, -1, -1):
        for i in range(z.shape[1]):
            s = p.h[k, i]
            for j in range(z.shape[1]):
                s += p.H[k, i, j] * z[k, j]
            gradient[i] = s
        for row in range(y.shape[1]):
            if y[k, row] != 0.0:
                for i in range(z.shape[1]):
                    gradient[i] += y[k, row] * p.G[k, row, i]
        if k < N:
            for j in range(n):
                for i in range(z.shape[1]):
                    gradient[i] += p.F[k, j, i] * costate[k + 1, j]
            for i in range(n, z.shape[1]):
                worst = max(worst, abs(gradient[i]))
                total += gradient[i]
        for i in range(n):
            costate[k, i] = gradient[i]
    return worst if np.isfinite(total) else np.nan


@jit_outlined
def optimality_error(p: Problem, z: Array, y: Array) -> float:
    """Return the largest violation of the Karush-Kuhn-Tucker (KKT) conditions; infinite if a number is not finite.

    The states follow from the inputs by the dynamics, and the duals of the dynamics from ``costates``. A row is right
    if its value is the point of [low, high] that is nearest to value + dual, or if its dual is its penalty and the
    value is beyond the bound; of a row that is not right, the smaller one of both errors counts.

    Parameters
    ----------
    p : problem.
    z : (N+1, n+m) solution; its inputs are read.
    y : (N+1, M) duals of the rows.
    """
    own, g = z.copy(), np.empty(y.shape)
    roll_out(p, own)
    worst = costates(p, own, y, np.empty((p.H.shape[0], p.f.shape[1])))
    if np.isnan(worst):
        return np.inf
    row_values(p, own, g)
    total = 0.0
    for k in range(y.shape[0]):
        for i in range(y.shape[1]):
            value, dual, cap = g[k, i], y[k, i], p.penalty[k, i]
            inside = p.high[k, i] - value if dual > 0.0 else value - p.low[k, i]
            error = max(inside, abs(abs(dual) - cap))  # as an exceeded row
            if abs(dual) < cap:
                nearest = min(max(value + dual, p.low[k, i]), p.high[k, i])
                error = min(error, abs(value - nearest))
            worst = max(worst, error)
            total += value + dual
    return worst if np.isfinite(total) else np.inf
