"""Convex quadratic programme (QP) and its solution, the common form of all solvers.

minimise 1/2 x' P x + q' x   subject to   l <= A x <= u
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csc_array

from ltv_mpc.messages import Array, Solve


@dataclass(frozen=True, slots=True)
class QP:
    """Convex quadratic programme; equalities have l == u."""

    P: csc_array  # (n, n) symmetric positive semidefinite, both triangles
    q: Array  # (n,)
    A: csc_array  # (m, n)
    l: Array  # noqa: E741  (m,)
    u: Array  # (m,)


@dataclass(frozen=True, slots=True)
class Solution:
    """Solution of a QP, and the solver's report."""

    x: Array  # (n,) primal
    y: Array  # (m,) dual of l <= A x <= u: positive at u, negative at l
    solve: Solve


@dataclass(frozen=True, slots=True)
class Residuals:
    """Residuals in the infinity norm; zero at the optimum."""

    stationarity: float  # P x + q + A' y
    primal: float  # violation of l <= A x <= u
    complementarity: float  # |y| times the distance from the bound that its sign names


def residuals(qp: QP, x: Array, y: Array) -> Residuals:
    """Return the residuals of a point.

    Parameters
    ----------
    qp : problem.
    x : (n,) primal point.
    y : (m,) dual, positive at u, negative at l.

    Returns
    -------
    Residuals of stationarity, feasibility and complementarity.
    """
    Ax = qp.A @ x
    stationarity = np.abs(qp.P @ x + qp.q + qp.A.T @ y).max()
    primal = max(np.maximum(qp.l - Ax, 0.0).max(), np.maximum(Ax - qp.u, 0.0).max())
    on = y != 0.0
    off = (np.where(y > 0.0, qp.u, qp.l) - Ax)[on]
    return Residuals(float(stationarity), float(primal), float(np.abs(y[on] * off).max(initial=0.0)))
