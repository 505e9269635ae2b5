"""The QP in public: built along any trajectory, solved by any solver."""

from __future__ import annotations

import numpy as np
import pytest

from ltv_mpc import build_qp, solve_qp
from ltv_mpc.control.linearisation import roll_out
from ltv_mpc.control.solvers.sparse import residuals
from ltv_mpc.vehicle.parameters import Vehicle

PAPER = Vehicle.load("paper")
P = PAPER.coefficients()


@pytest.mark.parametrize("solver", ["daqp", "osqp"])
def test_build_and_solve_are_public_for_any_trajectory(solver):
    N = 17
    U = np.zeros((N + 1, 2))
    C = np.zeros((N + 1, 2))
    X = roll_out(np.array([1.0, 0, 0.1, 0, 0, 0, 0, 0]), U, C, np.full(N, 0.3), P)
    qp = build_qp(PAPER, X, U, C, np.zeros((N, 2)))
    solution = solve_qp(qp, solver)
    kkt = residuals(qp, solution.x, solution.y)
    assert max(kkt.stationarity, kkt.primal, kkt.complementarity) < 1e-5
