"""Solver wrappers that keep what a solver was given and what it returned, also as a QP with the names of its rows."""

from __future__ import annotations

import contextlib
from collections.abc import Callable

from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.control.failed_qp import NamedQp
from ltv_mpc.control.ocp.assembly import scales
from ltv_mpc.control.ocp.problem import Problem
from ltv_mpc.control.solvers import SolverFactory, make
from ltv_mpc.control.solvers.interface import Result, Solver
from ltv_mpc.messages import Array, SolveStatus
from ltv_mpc.vehicle.parameters import Vehicle


class RecordingSolver:
    """Solver wrapper that keeps the last problem and its solution.

    ``problem`` is the controller's own: the next cycle overwrites it.
    """

    problem: Problem
    result: Result

    def __init__(self, solver: Solver, note: Callable[[Problem, Result], None] | None = None) -> None:
        """Wrap ``solver``; ``note`` is called after each solve."""
        self.solver, self._note = solver, note
        self.set_up = solver.set_up

    def solve(self, problem: Problem, shift: float, *, last: bool = True) -> Result:
        """Keep the problem and its solution, and return that.

        Parameters
        ----------
        problem, shift, last : as in ``Solver``.
        """
        self.problem = problem
        self.result = self.solver.solve(problem, shift, last=last)
        if self._note is not None:
            self._note(problem, self.result)
        return self.result


class QpRecorder:
    """Solver factory that gives the QP of the newest cycle on request, and keeps the last one that was not solved."""

    def __init__(self, make_solver: SolverFactory = make) -> None:
        """Wrap the solvers that ``make_solver`` makes."""
        self._make_solver = make_solver
        self._newest: tuple[Problem, Array, Result] | None = None  # with the problem's scales
        self.failed: NamedQp | None = None
        """The last QP that was not solved, if there was one."""

    def __call__(self, vehicle: Vehicle, config: ControllerConfig) -> Solver:
        """Return a solver for these settings."""
        scale = scales(vehicle)

        def note(problem: Problem, result: Result) -> None:
            self._newest = problem, scale, result
            if result.solve.status is not SolveStatus.SOLVED:
                with contextlib.suppress(Exception):  # a problem that cannot be laid out must not cost the cycle
                    self.failed = self.newest()

        return RecordingSolver(self._make_solver(vehicle, config), note)

    def newest(self) -> NamedQp | None:
        """Return the QP that was solved last, with the names of its rows: until the next cycle that of the plan.

        None before the first cycle that has one.
        """
        if self._newest is None:
            return None
        problem, scale, result = self._newest
        return NamedQp.of(problem, scale, result.solve)
