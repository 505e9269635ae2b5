"""OSQP on the sparse QP: one workspace, updated in place, with a step size for each kind of row.

OSQP's method (Stellato et al. 2020) is the alternating direction method of multipliers with one step size rho. No
single step size suits all kinds of row: the dynamics need 1e4 to 1e7 times that of the limits, and an active limit
100 times that of an inactive one. A row multiplied by s acts as if its step size were rho s^2, so the rows are scaled
and rho stays 1. The duals of the first guess show beforehand which limits are active. A changes in every cycle anyway,
so this needs no additional factorisation.

First guess: inputs and duals of all limits from the Riccati method (riccati.py), which nearly always are those of the
solution. A forward sweep gives the states that they lead to; a backward sweep gives the duals of the dynamics
(costates). OSQP then confirms the solution after one iteration. It does so for the last QP of a cycle, whose commands
are sent; the solution of one before it is taken if it meets the conditions of the optimum. Where the Riccati method
does not apply (a cost that does not determine the inputs), the guess is no deviation, with the duals of the previous
solve. The solver ``riccati`` is the same without the confirmation.

Over-relaxation is off: with step sizes this unequal the plain iteration is faster.

The solver is OSQP's binding, the class that its Python wrapper calls, too. The wrapper prepares derivatives of the
solution and copies all settings and results, which takes as long as two Riccati sweeps (docs/notes/problem-form.md).
"""

from __future__ import annotations

import math
import signal
from typing import NamedTuple

import numpy as np
from osqp import SolverStatus, ext_builtin
from scipy.sparse import csc_array, csc_matrix

from ltv_mpc.control.config import ResolvedConfig
from ltv_mpc.control.ocp.problem import Problem, costates, is_finite, optimality_error
from ltv_mpc.control.solvers import riccati
from ltv_mpc.control.solvers.active_set import CONVERGED
from ltv_mpc.control.solvers.interface import Result
from ltv_mpc.control.solvers.interior_point import MAX_OPTIMALITY_ERROR
from ltv_mpc.control.solvers.riccati import NOT_ACTIVE
from ltv_mpc.control.solvers.sparse import (
    DYNAMICS,
    EXCESS,
    HARD,
    LOWER,
    UPPER,
    Numbers,
    Places,
    SparseLayout,
    fill,
    fits,
    solution_of,
)
from ltv_mpc.control.solvers.sweep import Sweep
from ltv_mpc.jit import jit
from ltv_mpc.messages import Array, Solve, SolveStatus

SETTINGS = {
    "verbose": False,
    "scaling": 0,
    "rho": 1.0,
    # A state without a cost has only sigma on its diagonal. With OSQP's default of 1e-6, rows scaled by 300 leave
    # 300^2 / 1e-6 in the factor. Its solution then has an error beyond the tolerance where duals are large, for example
    # 10 m off a line.
    "sigma": 1e-4,
    "alpha": 1.0,
    "adaptive_rho": 0,
    "rho_is_vec": 0,
    "eps_rel": 0.0,
    "eps_prim_inf": 1e-12,  # box and slew always have a common point, so a certificate of infeasibility is of no use
    "eps_dual_inf": 1e-12,
    "check_dualgap": 0,
    "check_termination": 1,  # the first guess usually is the solution
    "polishing": 0,
    "time_limit": 1e10,
}
"""Plain ADMM on rows that are scaled already: step size 1, absolute residuals, limited by iterations, never by time."""

SOLVED, INTERRUPTED = int(SolverStatus.OSQP_SOLVED), int(SolverStatus.OSQP_SIGINT)

STATUS = {
    SOLVED: SolveStatus.SOLVED,
    int(SolverStatus.OSQP_SOLVED_INACCURATE): SolveStatus.ITERATION_LIMIT,
    int(SolverStatus.OSQP_MAX_ITER_REACHED): SolveStatus.ITERATION_LIMIT,
    int(SolverStatus.OSQP_PRIMAL_INFEASIBLE): SolveStatus.INFEASIBLE,
    int(SolverStatus.OSQP_PRIMAL_INFEASIBLE_INACCURATE): SolveStatus.INFEASIBLE,
    int(SolverStatus.OSQP_DUAL_INFEASIBLE): SolveStatus.INFEASIBLE,
    int(SolverStatus.OSQP_DUAL_INFEASIBLE_INACCURATE): SolveStatus.INFEASIBLE,
}
"""Status by OSQP's own; one that is missing here is ``FAILED``."""

INFINITE = 1e30
"""Bound that OSQP takes as none."""

EQUALITY_ROW = 300.0
"""Scale s of the dynamics; their step size is its square."""

LIMIT_ROW = 0.015
"""Scale s of inactive hard rows, if the gradient is small."""

GRADIENT = 0.5
"""Largest entry of q for which LIMIT_ROW holds. Duals grow with a larger q, and the step size with them."""

MAX_LIMIT_ROW = 0.2
"""Largest scale s of inactive hard rows."""

ROUNDING = 4e-9
"""Residual that rounding leaves, over the largest dual of the dynamics: with a fence no tolerance is below it. The dual
is 1e5 where two zones leave no room between them, and a row of the dynamics then is exact to 1e-6.
"""

ACTIVE = 10.0
"""Factor on the scale of active hard rows."""

SOFT_ROW, SOFT_ACTIVE, EXCESS_ROW = 0.05, 0.1, 5.0
"""Scales s of soft rows, inactive and active, and of the rows of their active excesses, if the gradient is small."""

NOT_EXCEEDED = 1e-3
"""Distance of a soft row's dual from its penalty above which the row is not exceeded."""

NOT_FINITE = -1.0
"""Size of a problem that has a number that is not finite."""


class Arrays(NamedTuple):
    """Numbers of one solve: the problem, the point, and both with scaled rows."""

    numbers: Numbers
    x: Array  # (n,) primal point: the first guess, then that of the last batch
    y: Array  # (m,) its dual
    scale: Array  # (m,) factor of each row
    A: Array  # stored entries of A, l and u with scaled rows
    l: Array  # noqa: E741
    u: Array
    scaled_y: Array

    @classmethod
    def empty(cls, layout: SparseLayout) -> Arrays:
        """Return the arrays of a layout, without numbers.

        Parameters
        ----------
        layout : gives the sizes.
        """
        n, m = layout.variables, layout.rows
        return cls(layout.allocate(), *(np.zeros(size) for size in (n, m, m, layout.A.nnz, m, m, m)))


class OsqpSolver:
    """OSQP on the sparse QP, from the solution of the Riccati sweeps: the default solver of the controller."""

    def __init__(self, config: ResolvedConfig, *, confirms: bool = True) -> None:
        """Set nothing up: the first problem gives the sizes.

        Parameters
        ----------
        config : knots, limit of iterations; ``tolerance`` is absolute, on residuals of the scaled problem.
        confirms : False: a solution of the sweeps that meets the conditions of the optimum is also that of the last QP
            of a cycle. OSQP solves the first one in any case, so that it is set up before it is needed.
        """
        self._knots, self._tolerance = config.knots, config.tolerance
        self._confirms = confirms
        self.layout: SparseLayout | None = None
        """Layout of the QP; ``arrays`` has the QP's numbers and its point, ``duals`` those of the limits (N+1, M)."""
        self.duals = np.zeros((0, 0))
        self._solver: ext_builtin.OSQPSolver | None = None
        self._settings = ext_builtin.OSQPSettings()
        ext_builtin.osqp_set_default_settings(self._settings)
        for name, value in SETTINGS.items():
            setattr(self._settings, name, value)
        self._settings.max_iter = config.max_iterations

    def set_up(self, problem: Problem) -> None:
        """Lay out the QP of a problem, and of those before it (see ``Solver``).

        Parameters
        ----------
        problem : gives sizes and pattern.
        """
        self._allocate(problem)
        self.layout = SparseLayout(problem, self.layout)
        self.arrays, self._solver = Arrays.empty(self.layout), None

    def _allocate(self, problem: Problem) -> None:
        """Make a workspace for problems of the size of this one, unless there is one."""
        if self.duals.shape != problem.low.shape:
            self.work, self.duals = Sweep.empty(problem), np.zeros(problem.low.shape)
            self.layout = self._solver = None

    def solve(self, problem: Problem, shift: float, *, last: bool = True) -> Result:
        """Solve a problem.

        Parameters
        ----------
        problem, shift, last : as in ``Solver``.
        """
        self._allocate(problem)
        outcome, sweeps = riccati.solve(problem, self.work, self._knots, shift, self.duals)
        if outcome == CONVERGED and not (last and (self._confirms or self._solver is None)):
            error = optimality_error(problem, self.work.z, self.duals)
            if error <= MAX_OPTIMALITY_ERROR:
                report = Solve(status=SolveStatus.SOLVED, iterations=sweeps, primal_residual=error, dual_residual=error)
                return Result(self.work.z.copy(), report)
        if self.layout is None or not fits(problem, self.layout.masks):
            if not is_finite(problem):  # its pattern would be wrong
                return self._no_solution("the problem is not finite")
            self.set_up(problem)
        return self._iterate(problem)

    def _iterate(self, p: Problem) -> Result:
        """Solve with OSQP from the result of the sweeps, for at most ``max_iterations``: never by time."""
        layout, at, settings = self.layout, self.arrays, self._settings
        assert layout is not None
        size, costate = prepare(p, layout.places, self.work, self.duals, at)
        if size == NOT_FINITE:  # a NaN would stay in the workspace for every later solve
            return self._no_solution("the problem is not finite")
        settings.eps_abs = max(self._tolerance * size, ROUNDING * costate if layout.soft_rows else 0.0)
        if self._solver is None:
            P, A = (_csc(of, data) for of, data in ((layout.P, at.numbers.P), (layout.A, at.A)))
            self._solver = ext_builtin.OSQPSolver(
                P, at.numbers.q, A, at.l, at.u, layout.rows, layout.variables, settings
            )
        solver = self._solver
        _load(solver, at)
        solver.update_settings(settings)
        solver.solve()
        info, solution = solver.info, solver.solution
        status, iterations = int(info.status_val), int(info.iter)
        if status == INTERRUPTED:
            signal.raise_signal(signal.SIGINT)  # OSQP catches Ctrl-C during a solve
        at.x[:], at.y[:] = solution.x, solution.y * at.scale
        if not math.isfinite(np.vdot(at.x, at.x) + np.vdot(at.y, at.y)):
            self._solver = None
            return self._no_solution("OSQP returned a value that is not finite; rebuilt")
        self.duals[:] = 0.0
        np.add.at(self.duals.reshape(-1), layout.places.source[layout.of_limit], at.y[layout.of_limit])
        report = STATUS.get(status, SolveStatus.FAILED)
        primal, dual, why = float(info.prim_res), float(info.dual_res), ""
        if report is not SolveStatus.SOLVED:
            named = report.value.replace("_", " ")
            why = f"OSQP: {named} after {iterations} iterations, primal residual {primal:.1e}, dual {dual:.1e}"
        solve = Solve(status=report, iterations=iterations, primal_residual=primal, dual_residual=dual, why=why)
        return Result(solution_of(p, at.x), solve)

    def _no_solution(self, why: str) -> Result:
        """Return no deviation and a report that says why; the warm start is discarded."""
        self.duals[:] = 0.0
        return Result(np.zeros_like(self.work.z), Solve(status=SolveStatus.NON_FINITE, why=why))


def _load(solver: ext_builtin.OSQPSolver, at: Arrays) -> None:
    """Pass numbers and point to OSQP, which copies them and factorises."""
    errors = solver.update_data_mat(at.numbers.P, None, at.A, None), solver.update_data_vec(at.numbers.q, at.l, at.u)
    if any(errors):
        raise ArithmeticError(f"OSQP rejects the problem, errors {errors} of matrices and vectors")
    solver.warm_start(at.x, at.scaled_y)


def _csc(pattern: csc_array, data: Array) -> ext_builtin.CSC:
    """Return a matrix in OSQP's types."""
    parts = data, pattern.indices.astype(np.int32), pattern.indptr.astype(np.int32)
    return ext_builtin.CSC(csc_matrix(parts, shape=pattern.shape))


@jit
def prepare(p: Problem, places: Places, work: Sweep, duals: Array, at: Arrays) -> tuple[float, float]:
    """Compute the QP of a problem and its first guess, unscaled and with scaled rows.

    Parameters
    ----------
    p : problem, which fits the layout.
    places : of the layout.
    work : result of the sweeps (``riccati.solve``).
    duals : (N+1, M) its duals of the limits.
    at : overwritten.

    Returns
    -------
    ``dual_scale`` of the problem, or ``NOT_FINITE``; largest magnitude of a dual of the dynamics.
    """
    fill(p, places, at.numbers)
    N, n, largest = len(p.f), p.f.shape[1], 0.0
    costate = np.zeros((N + 1, n))
    costates(p, work.z, duals, costate)
    for i in range(N * p.h.shape[1]):
        at.x[i] = work.z.flat[n + i]
    for row in range(len(places.kind)):
        kind, i = places.kind[row], places.source[row]
        if kind == DYNAMICS:
            at.y[row] = costate[i // n + 1, i % n]
            largest = max(largest, abs(at.y[row]))
        elif kind == HARD:
            at.y[row] = duals.flat[i]
        elif kind == UPPER:
            at.y[row] = max(duals.flat[i], 0.0)
        elif kind == LOWER:
            at.y[row] = min(duals.flat[i], 0.0)
        else:
            excess, penalty = places.excess.flat[i], p.penalty.flat[i]
            at.y[row] = min(abs(duals.flat[i]) - min(penalty, at.numbers.q[excess]), 0.0)
            over = max(work.g.flat[i] - p.high.flat[i], p.low.flat[i] - work.g.flat[i], 0.0)
            at.x[excess] = over if at.y[row] > -NOT_EXCEEDED else 0.0
    size = dual_scale(at.numbers.q[: N * p.h.shape[1]])
    return (size if scale_rows(places, at, size) else NOT_FINITE), largest


@jit
def dual_scale(q: Array) -> float:
    """Return the factor by which duals, and so step sizes and residuals, are larger than for a small gradient.

    The cost of an excess does not count as gradient: it acts only beyond a limit.

    Parameters
    ----------
    q : linear cost of states and inputs.

    Returns
    -------
    Factor >= 1.
    """
    return float(max(1.0, np.sqrt(np.abs(q).max() / GRADIENT)))


@jit
def scale_rows(places: Places, at: Arrays, size: float) -> bool:
    """Scale the rows of the problem and of its dual, by the limits that the dual shows to be active.

    Parameters
    ----------
    places : kinds of the rows.
    at : its scaled parts are overwritten.
    size : ``dual_scale`` of the problem.

    Returns
    -------
    False if a number is not finite.
    """
    numbers, y = at.numbers, at.y
    free = min(LIMIT_ROW * size, MAX_LIMIT_ROW)
    total = np.sum(numbers.q) + np.sum(numbers.P)
    for i in range(len(y)):
        kind, active = places.kind[i], abs(y[i]) > NOT_ACTIVE
        if kind == DYNAMICS:
            s = EQUALITY_ROW
        elif kind == HARD:
            s = free * ACTIVE if active else free
        elif not active:
            s = SOFT_ROW * size
        else:
            s = (EXCESS_ROW if kind == EXCESS else SOFT_ACTIVE) * size
        at.scale[i] = s
        at.l[i], at.u[i], at.scaled_y[i] = max(numbers.l[i] * s, -INFINITE), min(numbers.u[i] * s, INFINITE), y[i] / s
        total += y[i]
        if np.isnan(numbers.l[i]) or np.isnan(numbers.u[i]) or (kind == DYNAMICS and np.isinf(numbers.l[i])):
            return False
    for i in range(len(at.A)):
        at.A[i] = numbers.A[i] * at.scale[places.row[i]]
        total += at.A[i]
    return bool(np.isfinite(total))
