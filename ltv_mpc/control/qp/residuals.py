"""How far a point is from the optimum: the residuals of the Karush-Kuhn-Tucker conditions, for any solver's answer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ltv_mpc.control.qp.problem import QP
from ltv_mpc.messages import Array


@dataclass(frozen=True, slots=True)
class Residuals:
    """All in the infinity norm; zero at the optimum."""

    stationarity: float  # P x + q + A' y
    primal: float  # violation of l <= A x <= u
    complementarity: float  # |y| times the distance from the bound that its sign names


def residuals(qp: QP, x: Array, y: Array) -> Residuals:
    """Residuals of x (n,), y (m,)."""
    Ax = qp.A @ x
    stationarity = np.abs(qp.P @ x + qp.q + qp.A.T @ y).max()
    primal = max(np.maximum(qp.l - Ax, 0.0).max(), np.maximum(Ax - qp.u, 0.0).max())
    upper, lower = np.maximum(y, 0.0), np.maximum(-y, 0.0)
    to_upper = np.where(upper > 0, upper * np.abs(qp.u - Ax), 0.0)
    to_lower = np.where(lower > 0, lower * np.abs(Ax - qp.l), 0.0)
    return Residuals(float(stationarity), float(primal), float(max(to_upper.max(), to_lower.max())))
