"""Any solver that qpsolvers knows and that is installed, by name: for comparison, and where OSQP is not wanted."""

from __future__ import annotations

import numpy as np
import qpsolvers
from scipy.sparse import csc_matrix, vstack

from ltv_mpc.control.qp.problem import QP, Solution
from ltv_mpc.signals import Array, Solve, SolveStatus


def known_solvers() -> list[str]:
    """Names of the installed solvers."""
    return list(qpsolvers.available_solvers)


class ByName:
    """One of qpsolvers' backends, from nothing in each cycle."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._dense = name in qpsolvers.dense_solvers and name not in qpsolvers.sparse_solvers

    def solve(self, qp: QP, warm_x: Array, warm_y: Array) -> Solution:
        """Solve; the first guess of the primal is handed on."""
        del warm_y  # qpsolvers has no place for it
        equal = qp.l == qp.u
        # qpsolvers' form: G x <= h, A x = b
        E, G = csc_matrix(qp.A)[equal], csc_matrix(qp.A)[~equal]
        two_sided = vstack([G, -G], format="csc")
        h = np.concatenate([qp.u[~equal], -qp.l[~equal]])
        if self._dense:
            problem = qpsolvers.Problem(qp.P.toarray(), qp.q, two_sided.toarray(), h, E.toarray(), qp.l[equal])
        else:
            problem = qpsolvers.Problem(csc_matrix(qp.P), qp.q, csc_matrix(two_sided), h, csc_matrix(E), qp.l[equal])
        try:
            answer = qpsolvers.solve_problem(problem, solver=self._name, initvals=warm_x)
        except Exception as error:  # each backend has its own exceptions, and a failed solve is a value here
            return self._nothing(qp, SolveStatus.FAILED, f"{self._name}: {error}")
        if not answer.found or answer.x is None:
            return self._nothing(qp, SolveStatus.FAILED, f"{self._name}: no solution")
        if not np.isfinite(answer.x).all():
            return self._nothing(qp, SolveStatus.NON_FINITE, f"{self._name} returned a value that is not finite")
        y = np.zeros(len(qp.l))
        if answer.y is not None and answer.z is not None:
            y[equal] = answer.y
            half = int((~equal).sum())
            y[~equal] = answer.z[:half] - answer.z[half:]
        return Solution(np.array(answer.x), y, Solve(status=SolveStatus.SOLVED))

    @staticmethod
    def _nothing(qp: QP, status: SolveStatus, why: str) -> Solution:
        return Solution(np.zeros(len(qp.q)), np.zeros(len(qp.l)), Solve(status=status, why=why))
