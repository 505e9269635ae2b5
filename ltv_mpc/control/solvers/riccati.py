"""Riccati solver: it finds the active limits, and solves the rest by Riccati sweeps (sweep.py).

The dual y of a hard row has no bound. A soft row may be exceeded at its penalty for each unit, so that
-penalty <= y <= penalty:  at the bound the row is exceeded. Two methods find y, the second where the first does not
converge: from the rows that were active in the last solve (active_set.py), and from any start (interior_point.py).

The result is exact to 1e-7 of a row's unit. The method is the solver ``riccati``, which checks the optimality
conditions of its result and hands a problem that fails to OSQP. The solver ``osqp`` takes the result as a first guess,
and has only to check its residuals.
"""

from __future__ import annotations

import math

import numpy as np

from ltv_mpc.control import shooting_grid
from ltv_mpc.control.config import ResolvedConfig
from ltv_mpc.control.ocp.problem import Problem, is_finite, optimality_error
from ltv_mpc.control.solvers.active_set import CONVERGED, FAILED, NOT_CONVERGED, active_rows, active_set
from ltv_mpc.control.solvers.interface import Result, Solver
from ltv_mpc.control.solvers.interior_point import MAX_OPTIMALITY_ERROR, interior_point
from ltv_mpc.control.solvers.sweep import Sweep
from ltv_mpc.jit import jit
from ltv_mpc.messages import Array, Solve, SolveStatus

FIRST_SWEEPS = 14
"""Limit of the active-set sweeps with the last solve's rows."""

MAX_SWEEPS = 60
"""Limit of sweeps. Rows that nearly depend on each other take 20 to 36, other problems seen at most 30."""


class RiccatiSolver:
    """Riccati method as a solver of the controller, with another solver for problems that it does not solve."""

    max_error = MAX_OPTIMALITY_ERROR
    """Largest optimality error of a result that is used."""

    def __init__(self, config: ResolvedConfig, other: Solver | None = None) -> None:
        """Allocate nothing: the first problem gives the sizes.

        Parameters
        ----------
        config : knots and limit of iterations.
        other : solves the problems whose result here violates the optimality conditions. It also solves the first
            problem, so that it is compiled and set up before it is needed. None: such a problem is not solved.
        """
        self._other, self._other_is_ready = other, False
        self._max_sweeps, self._knots = config.max_iterations, config.knots
        self._shift = math.nan
        self._problem: Problem | None = None
        self._duals = np.zeros((0, 0))

    def shift_warm_start(self, stages: float) -> None:
        """Move the duals with the plan; the last ones are held.

        Parameters
        ----------
        stages : by how many first stages the next problem's knots lie later than the last one's.
        """
        self._shift = stages

    def reset_warm_start(self) -> None:
        """Start the next solve with no active row."""
        self._shift = math.nan

    def build(self, problem: Problem) -> None:
        """Keep the problem: the sweeps read it as it is.

        Parameters
        ----------
        problem : is read by ``solve``.
        """
        if self._duals.shape != problem.low.shape:
            self._duals, self._work = np.zeros(problem.low.shape), Sweep.empty(problem)
            self.reset_warm_start()
            if self._other is not None:
                self._other.build(problem)  # its pattern, too, is that of the first problem
        self._problem = problem

    def update(self) -> None:
        """Do nothing: there is no workspace to update."""

    def solve(self) -> Result:
        """Solve the problem (see ``Solver``)."""
        assert self._problem is not None, "build() must be called before solve()"
        outcome, sweeps, violation, error = solve_from(
            self._problem, self._work, self._knots, self._shift, self._max_sweeps, self._duals
        )
        solved = outcome == CONVERGED and error <= self.max_error
        if self._other is not None and not (solved and self._other_is_ready):
            result = self._hand_over(self._other)
            if not solved:
                self._shift = math.nan if outcome == FAILED else 0.0
                return result
        if outcome == FAILED:
            self.reset_warm_start()
            finite = is_finite(self._problem)
            why = "the cost is singular: it does not determine the inputs" if finite else "the problem is not finite"
            status = SolveStatus.FAILED if finite else SolveStatus.NON_FINITE
            return Result(np.zeros_like(self._work.z), Solve(status=status, iterations=sweeps, why=why))
        self._shift = 0.0
        why = "" if solved else f"optimality error {error:.1e} after {sweeps} Riccati sweeps"
        status = SolveStatus.SOLVED if solved else SolveStatus.ITERATION_LIMIT
        solve = Solve(status=status, iterations=sweeps, primal_residual=violation, dual_residual=error, why=why)
        return Result(self._work.z.copy(), solve)

    def _hand_over(self, other: Solver) -> Result:
        """Return the other solver's result of the same problem, from no warm start."""
        assert self._problem is not None
        self._other_is_ready = True
        other.reset_warm_start()
        other.build(self._problem)
        other.update()
        return other.solve()


@jit
def solve_from(
    p: Problem, work: Sweep, t: Array, stages: float, max_sweeps: int, y: Array
) -> tuple[int, int, float, float]:
    """Solve a problem from the duals of an earlier one.

    Parameters
    ----------
    p : problem.
    work : is overwritten; its z is the solution.
    t : (N+1,) knots in first stages.
    stages : by how many first stages the knots of the earlier problem lie earlier; NaN if there is none.
    max_sweeps : limit of sweeps; the solve can take two more.
    y : (N+1, M) duals of the earlier problem; overwritten with those of this one.

    Returns
    -------
    Outcome, number of sweeps and largest violation, as ``solve``; then ``optimality_error``.
    """
    shooting_grid.shift(y, t, stages)
    outcome, sweeps, violation = solve(p, work, max_sweeps, y)
    return outcome, sweeps, violation, optimality_error(p, work.z, y)


@jit
def solve(p: Problem, work: Sweep, max_sweeps: int, y: Array) -> tuple[int, int, float]:
    """Solve a problem.

    Parameters
    ----------
    p : problem.
    work : is overwritten; its z is the solution.
    max_sweeps : limit of sweeps; the solve can take two more.
    y : (N+1, M) duals of the last solve, which show the first active set; overwritten with those of this one.

    Returns
    -------
    FAILED, NOT_CONVERGED or CONVERGED; number of sweeps; largest violation of the hard rows.
    """
    active = active_rows(p, y)
    outcome, sweeps = active_set(p, work, active, FIRST_SWEEPS, y)
    if outcome == NOT_CONVERGED:
        outcome, more = interior_point(p, work, active, max_sweeps - sweeps, y)
        sweeps += more
    if outcome == FAILED:
        work.z[:, :] = 0.0
        y[:, :] = 0.0
        return outcome, sweeps, 0.0
    violation = 0.0
    for i in range(y.size):
        if np.isinf(p.penalty.flat[i]):
            violation = max(violation, work.g.flat[i] - p.high.flat[i], p.low.flat[i] - work.g.flat[i])
    return outcome, sweeps, violation
