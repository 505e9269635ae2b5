"""OSQP on the sparse QP: set up once, updated in place, warm started in primal and dual.

The problem comes scaled (qp/sparse.py), so OSQP's own scaling and step adaptation are off, and every solve starts from
an explicit guess: its answer depends on that QP and that guess alone, bit for bit. It is limited by iterations, never
by time.
"""

from __future__ import annotations

import signal

import numpy as np
import osqp
from scipy.sparse import csc_array, csc_matrix, triu

from ltv_mpc.control.qp.problem import QP, Solution
from ltv_mpc.signals import Array, Solve, SolveStatus

RHO = 0.02
"""First ADMM step size of box and slew rows; the equalities' is larger by the square of their row scale."""

GROWTH = (1.0, 10.0, 100.0)
"""Where a turn has not converged, duals are large and want a larger step: the step sizes are taken in turn.

With one step size for all, the hard cycles (metres off the line) needed thousands of iterations.
"""

GRADIENT = 10.0
"""Largest entry of q up to which RHO is the first step size; beyond, duals grow with q, and the step size with them."""

TURN = 50
"""Iterations with one step size."""

_STATUS = {
    int(osqp.SolverStatus.OSQP_SOLVED): SolveStatus.SOLVED,
    int(osqp.SolverStatus.OSQP_SOLVED_INACCURATE): SolveStatus.ITERATION_LIMIT,
    int(osqp.SolverStatus.OSQP_MAX_ITER_REACHED): SolveStatus.ITERATION_LIMIT,
    int(osqp.SolverStatus.OSQP_PRIMAL_INFEASIBLE): SolveStatus.INFEASIBLE,
    int(osqp.SolverStatus.OSQP_PRIMAL_INFEASIBLE_INACCURATE): SolveStatus.INFEASIBLE,
    int(osqp.SolverStatus.OSQP_DUAL_INFEASIBLE): SolveStatus.INFEASIBLE,
    int(osqp.SolverStatus.OSQP_DUAL_INFEASIBLE_INACCURATE): SolveStatus.INFEASIBLE,
}


class Osqp:
    """One OSQP workspace for problems of one pattern."""

    def __init__(self, max_iterations: int, tolerance: float) -> None:
        """``tolerance`` is absolute, on the scaled problem's residuals."""
        self._settings = {
            "verbose": False,
            "scaling": 0,
            "rho": RHO,
            "adaptive_rho": 0,
            "rho_is_vec": 0,
            "eps_abs": tolerance,
            "eps_rel": 0.0,
            "eps_prim_inf": 1e-12,  # box and slew always have a common point: nothing is gained by looking for a proof
            "eps_dual_inf": 1e-12,
            "check_dualgap": 0,
            "check_termination": 5,
            "max_iter": TURN,
            "polishing": 0,
            "time_limit": 1e10,
        }
        self._turns = max(1, -(-max_iterations // TURN))
        self._rho = RHO
        self._solver: osqp.OSQP | None = None

    def solve(self, qp: QP, warm_x: Array, warm_y: Array) -> Solution:
        """Solve from the guess (n,), (m,). A non-finite answer is reported as such and the workspace made anew."""
        if not all(np.isfinite(part).all() for part in (qp.q, qp.A.data, qp.l, qp.u, warm_x, warm_y)):
            # One NaN would poison the workspace for every later solve.
            return _nothing(qp, SolveStatus.NON_FINITE, "the problem or its first guess is not finite")
        solver = self._loaded(qp)
        iterations = 0
        # In powers of ten: a step size that differs from the last costs a factorisation.
        first = RHO * 10.0 ** round(np.log10(max(1.0, np.abs(qp.q).max() / GRADIENT)))
        for turn in range(self._turns):
            self._step_size(first * GROWTH[turn % len(GROWTH)])
            solver.warm_start(x=warm_x, y=warm_y)
            result = solver.solve(raise_error=False)
            interrupted = int(result.info.status_val) == int(osqp.SolverStatus.OSQP_SIGINT)
            if interrupted:  # OSQP takes a Ctrl-C for itself while it solves: hand it on to whoever waits for it
                signal.raise_signal(signal.SIGINT)
            iterations += int(result.info.iter)
            warm_x, warm_y = np.array(result.x), np.array(result.y)
            if not (np.isfinite(warm_x).all() and np.isfinite(warm_y).all()):
                self._solver = None
                return _nothing(qp, SolveStatus.NON_FINITE, "OSQP returned a value that is not finite; rebuilt")
            if interrupted or int(result.info.status_val) == int(osqp.SolverStatus.OSQP_SOLVED):
                break
        info = result.info
        status = _STATUS.get(int(info.status_val), SolveStatus.FAILED)
        why = ""
        if status is not SolveStatus.SOLVED:
            residuals = f"primal residual {info.prim_res:.1e}, dual {info.dual_res:.1e}"
            why = f"OSQP: {info.status} after {iterations} iterations, {residuals}"
        solve = Solve(
            status=status,
            iterations=iterations,
            primal_residual=float(info.prim_res),
            dual_residual=float(info.dual_res),
            why=why,
        )
        return Solution(warm_x, warm_y, solve)

    def _loaded(self, qp: QP) -> osqp.OSQP:
        """The workspace with this cycle's numbers in it."""
        if self._solver is None:
            self._solver = osqp.OSQP()
            self._rho = RHO
            # The matrices belong to OSQP afterwards: it gets copies.
            P = csc_matrix(triu(qp.P, format="csc"))
            self._solver.setup(P, qp.q.copy(), csc_matrix(qp.A).copy(), qp.l.copy(), qp.u.copy(), **self._settings)
        else:
            self._solver.update(q=qp.q, Ax=_data(qp.A), l=qp.l, u=qp.u)
        return self._solver

    def _step_size(self, rho: float) -> None:
        """Each solve's step sizes are its own: nothing of the last one is left."""
        if rho != self._rho and self._solver is not None:
            self._solver.update_settings(rho=rho)
            self._rho = rho


def _data(A: csc_array) -> Array:
    return np.ascontiguousarray(A.data, dtype=np.float64)


def _nothing(qp: QP, status: SolveStatus, why: str) -> Solution:
    return Solution(np.zeros(len(qp.q)), np.zeros(len(qp.l)), Solve(status=status, why=why))
