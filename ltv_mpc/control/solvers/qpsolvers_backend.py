"""Backends of qpsolvers as solvers of the controller: every installed one, by its name.

qpsolvers imports every backend that it finds, which takes 0.3 s. So it is imported only where a backend is used.
"""

from __future__ import annotations

import warnings

import numpy as np
from scipy.sparse import csc_matrix, vstack

from ltv_mpc.control.config import ResolvedConfig
from ltv_mpc.control.ocp.problem import Problem
from ltv_mpc.control.solvers.interface import Result
from ltv_mpc.control.solvers.sparse import QP, Solution, solution_of, sparse_qp
from ltv_mpc.errors import SolverNotInstalled
from ltv_mpc.messages import Solve, SolveStatus


def installed_backends() -> list[str]:
    """Return the names of the installed backends of qpsolvers."""
    import qpsolvers

    return list(qpsolvers.available_solvers)


class QpsolversBackend:
    """Backend of qpsolvers on the sparse QP; each cycle starts without a warm start."""

    def __init__(self, config: ResolvedConfig) -> None:
        """Take the settings.

        Parameters
        ----------
        config : ``config.solver`` names the backend.
        """
        self._name = config.solver

    def set_up(self, problem: Problem) -> None:
        """Do nothing: the backend has no workspace.

        Parameters
        ----------
        problem : is not used.
        """

    def solve(self, problem: Problem, shift: float, *, last: bool = True) -> Result:  # noqa: ARG002
        """Solve a problem.

        Parameters
        ----------
        problem, shift, last : as in ``Solver``; the problem alone is used.
        """
        solution = solve_qp(sparse_qp(problem), self._name)
        return Result(solution_of(problem, solution.x), solution.solve)


def solve_qp(qp: QP, solver: str = "osqp") -> Solution:
    """Solve one QP with a backend of qpsolvers, without a warm start.

    Parameters
    ----------
    qp : problem.
    solver : name of the backend.

    Returns
    -------
    Solution; its report says why there is none, if so.

    Raises
    ------
    SolverNotInstalled
        The backend is not known or not installed.
    """
    import qpsolvers

    if solver not in installed_backends():
        raise SolverNotInstalled(
            "option --solver",
            "",
            f"is not installed or not known; installed: {', '.join(sorted(installed_backends()))}",
            value=solver,
        )
    equal = qp.l == qp.u
    # qpsolvers' form: G x <= h, A x = b
    E, G = csc_matrix(qp.A)[equal], csc_matrix(qp.A)[~equal]
    h = np.concatenate([qp.u[~equal], -qp.l[~equal]])
    bound = ~np.isposinf(h)  # some backends take no infinite bound
    two_sided, h = vstack([G, -G], format="csr")[bound], h[bound]
    if not all(np.isfinite(part).all() for part in (qp.P.data, qp.q, qp.A.data, h, qp.l[equal])):
        return _no_solution(qp, SolveStatus.NON_FINITE, "the problem is not finite")
    problem = qpsolvers.Problem(csc_matrix(qp.P), qp.q, csc_matrix(two_sided), h, csc_matrix(E), qp.l[equal])
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # deprecations of a backend concern qpsolvers, not the user
            result = qpsolvers.solve_problem(problem, solver, None, False, **EXACT.get(solver, {}))
    except Exception as error:  # each backend has its own exceptions, and a failed solve is a value here
        return _no_solution(qp, SolveStatus.FAILED, f"{solver}: {error}")
    if not result.found or result.x is None:
        return _no_solution(qp, SolveStatus.FAILED, f"{solver}: no solution")
    if not np.isfinite(result.x).all():
        return _no_solution(qp, SolveStatus.NON_FINITE, f"{solver} returned a value that is not finite")
    y = np.zeros(len(qp.l))
    if result.y is not None and result.z is not None:
        y[equal] = result.y
        z = np.zeros(len(bound))
        z[bound] = result.z
        y[~equal] = np.subtract(*z.reshape(2, -1))
    return Solution(np.array(result.x), y, Solve(status=SolveStatus.SOLVED))


EXACT: dict[str, dict[str, float]] = {
    "osqp": {"eps_abs": 1e-7, "eps_rel": 1e-7, "max_iter": 100_000, "polishing": True},
    "piqp": dict.fromkeys(("eps_abs", "eps_rel", "eps_duality_gap_abs", "eps_duality_gap_rel"), 1e-10),
}
"""Settings of backends whose defaults are too coarse."""


def _no_solution(qp: QP, status: SolveStatus, why: str) -> Solution:
    """Return zeros as the solution, and a report that says why."""
    return Solution(np.zeros(len(qp.q)), np.zeros(len(qp.l)), Solve(status=status, why=why))
