"""Backends of qpsolvers as solvers of the controller: every installed one, by its name.

qpsolvers imports every backend that it finds, which takes 0.3 s. So it is imported only where a backend is used.
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


def installed_backends() -> list[str]:
    """Return the names of the installed backends of qpsolvers."""
    import qpsolvers

    return list(qpsolvers.available_solvers)


class QpsolversBackend:
    """Backend of qpsolvers on the sparse QP; each cycle starts without a warm start."""

    def __init__(self, config: ResolvedConfig, limits: HorizonLimits) -> None:
        """Lay out the QP.

        Parameters
        ----------
        config : ``config.solver`` names the backend.
        limits : limits of thrusters and motion.
        """
        self._name = config.solver
        self._form = SparseQp(config.knots, limits, config.weights)
        self._lin: Linearisation | None = None
        self._qp: QP | None = None

    def shift_warm_start(self, stages: float) -> None:
        """Do nothing: there is no warm start.

        Parameters
        ----------
        stages : is not used.
        """

    def reset_warm_start(self) -> None:
        """Do nothing: there is no warm start."""

    def build(self, lin: Linearisation, target: Array) -> None:
        """Build the QP (see ``Solver``).

        Parameters
        ----------
        lin : the motion along the nominal trajectory.
        target : (N+1, 3) as in ``Solver.build``.
        """
        self._lin, self._qp = lin, self._form.build(lin, target)

    def update(self) -> None:
        """Do nothing: the backend takes the whole problem at once."""

    def solve(self) -> SolverResult:
        """Solve the QP (see ``Solver``)."""
        assert self._lin is not None, "build() must be called before solve()"
        assert self._qp is not None, "build() must be called before solve()"
        solution = solve_qp(self._qp, self._name)
        return SolverResult(self._form.commands(self._lin, solution.x), solution.solve)


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
    ConfigError
        The backend is not known or not installed.
    """
    import qpsolvers

    if solver not in installed_backends():
        raise ConfigError(
            "option --solver",
            "",
            f"is not installed or not known; installed: {', '.join(sorted(installed_backends()))}",
            value=solver,
        )
    equal = qp.l == qp.u
    # qpsolvers' form: G x <= h, A x = b
    E, G = csc_matrix(qp.A)[equal], csc_matrix(qp.A)[~equal]
    two_sided = vstack([G, -G], format="csc")
    h = np.concatenate([qp.u[~equal], -qp.l[~equal]])
    if not all(np.isfinite(part).all() for part in (qp.P.data, qp.q, qp.A.data, qp.l, qp.u)):
        return _no_solution(qp, SolveStatus.NON_FINITE, "the problem is not finite")
    if solver in qpsolvers.dense_solvers and solver not in qpsolvers.sparse_solvers:
        problem = qpsolvers.Problem(qp.P.toarray(), qp.q, two_sided.toarray(), h, E.toarray(), qp.l[equal])
    else:
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
        half = int((~equal).sum())
        y[~equal] = result.z[:half] - result.z[half:]
    return Solution(np.array(result.x), y, Solve(status=SolveStatus.SOLVED))


EXACT: dict[str, dict[str, float]] = {
    "osqp": {"eps_abs": 1e-7, "eps_rel": 1e-7, "max_iter": 100_000, "polishing": True}
}
"""Settings of backends whose defaults are too coarse."""


def _no_solution(qp: QP, status: SolveStatus, why: str) -> Solution:
    """Return zeros as the solution, and a report that says why."""
    return Solution(np.zeros(len(qp.q)), np.zeros(len(qp.l)), Solve(status=status, why=why))
