"""Any solver that qpsolvers knows and that is installed, by name: for comparison, and where OSQP is not wanted.

qpsolvers imports every backend that it finds, 0.3 s; so it is imported where one is asked for, and nowhere else.
"""

from __future__ import annotations

import warnings

import numpy as np
from scipy.sparse import csc_matrix, vstack

from ltv_mpc.control.config import ResolvedConfig
from ltv_mpc.control.horizon_limits import HorizonLimits
from ltv_mpc.control.linearisation import Linearisation
from ltv_mpc.control.qp.problem import QP, Solution
from ltv_mpc.control.qp.sparse import SparseQp
from ltv_mpc.control.solvers.interface import SolverResult
from ltv_mpc.errors import ConfigError
from ltv_mpc.messages import Array, Solve, SolveStatus


def known_solvers() -> list[str]:
    """Names of the installed solvers."""
    import qpsolvers

    return list(qpsolvers.available_solvers)


class QpsolversBackend:
    """One of qpsolvers' backends on the sparse QP, from nothing in each cycle."""

    def __init__(self, config: ResolvedConfig, limits: HorizonLimits) -> None:
        """``config`` names the backend."""
        self._name = config.solver
        self._form = SparseQp(config.knots, limits, config.weights)
        self._lin: Linearisation | None = None
        self._qp: QP | None = None

    def shift_warm_start(self, stages: float) -> None:
        """As in ``Solver``; it has no warm start."""

    def reset_warm_start(self) -> None:
        """As in ``Solver``; it has no warm start."""

    def build(self, lin: Linearisation, target: Array) -> None:
        """As in ``Solver``."""
        self._lin, self._qp = lin, self._form.build(lin, target)

    def update(self) -> None:
        """As in ``Solver``; the backend takes the whole problem at once."""

    def solve(self) -> SolverResult:
        """As in ``Solver``."""
        assert self._lin is not None, "build() must be called before solve()"
        assert self._qp is not None, "build() must be called before solve()"
        solution = solve_qp(self._qp, self._name)
        return SolverResult(self._form.commands(self._lin, solution.x), solution.solve)


def solve_qp(qp: QP, solver: str = "osqp") -> Solution:
    """Solve one QP from nothing with any installed solver. Raises ``ConfigError`` for an unknown name."""
    import qpsolvers

    if solver not in known_solvers():
        raise ConfigError(
            "option solver",
            "",
            f"is not installed or not known; installed: {', '.join(sorted(known_solvers()))}",
            value=solver,
        )
    equal = qp.l == qp.u
    # qpsolvers' form: G x <= h, A x = b
    E, G = csc_matrix(qp.A)[equal], csc_matrix(qp.A)[~equal]
    two_sided = vstack([G, -G], format="csc")
    h = np.concatenate([qp.u[~equal], -qp.l[~equal]])
    if not all(np.isfinite(part).all() for part in (qp.P.data, qp.q, qp.A.data, qp.l, qp.u)):
        return _nothing(qp, SolveStatus.NON_FINITE, "the problem is not finite")
    if solver in qpsolvers.dense_solvers and solver not in qpsolvers.sparse_solvers:
        problem = qpsolvers.Problem(qp.P.toarray(), qp.q, two_sided.toarray(), h, E.toarray(), qp.l[equal])
    else:
        problem = qpsolvers.Problem(csc_matrix(qp.P), qp.q, csc_matrix(two_sided), h, csc_matrix(E), qp.l[equal])
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what a backend deprecates is between it and qpsolvers
            answer = qpsolvers.solve_problem(problem, solver, None, False, **EXACT.get(solver, {}))
    except Exception as error:  # each backend has its own exceptions, and a failed solve is a value here
        return _nothing(qp, SolveStatus.FAILED, f"{solver}: {error}")
    if not answer.found or answer.x is None:
        return _nothing(qp, SolveStatus.FAILED, f"{solver}: no solution")
    if not np.isfinite(answer.x).all():
        return _nothing(qp, SolveStatus.NON_FINITE, f"{solver} returned a value that is not finite")
    y = np.zeros(len(qp.l))
    if answer.y is not None and answer.z is not None:
        y[equal] = answer.y
        half = int((~equal).sum())
        y[~equal] = answer.z[:half] - answer.z[half:]
    return Solution(np.array(answer.x), y, Solve(status=SolveStatus.SOLVED))


EXACT: dict[str, dict[str, float]] = {
    "osqp": {"eps_abs": 1e-7, "eps_rel": 1e-7, "max_iter": 100_000, "polishing": True}
}
"""What a backend needs to be told where its defaults are coarse."""


def _nothing(qp: QP, status: SolveStatus, why: str) -> Solution:
    return Solution(np.zeros(len(qp.q)), np.zeros(len(qp.l)), Solve(status=status, why=why))
