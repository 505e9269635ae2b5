"""Residuals of the Karush-Kuhn-Tucker conditions: the distance of any solver's result from the optimum."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ltv_mpc.control.qp.problem import QP
from ltv_mpc.messages import Array


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
    upper, lower = np.maximum(y, 0.0), np.maximum(-y, 0.0)
    to_upper = np.where(upper > 0, upper * np.abs(qp.u - Ax), 0.0)
    to_lower = np.where(lower > 0, lower * np.abs(Ax - qp.l), 0.0)
    return Residuals(float(stationarity), float(primal), float(max(to_upper.max(), to_lower.max())))
