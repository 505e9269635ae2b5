"""Solver wrappers that keep what a solver was given and what it returned, also as a QP with the names of its rows."""

from __future__ import annotations

import contextlib

from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.control.failed_qp import NamedQp, row_names
from ltv_mpc.control.ocp.assembly import scales
from ltv_mpc.control.ocp.problem import Problem
from ltv_mpc.control.solvers import SolverFactory, make
from ltv_mpc.control.solvers.interface import Result, Solver
from ltv_mpc.control.solvers.sparse import SparseLayout
from ltv_mpc.messages import Array, SolveStatus
from ltv_mpc.vehicle.parameters import Vehicle


class RecordingSolver:
    """Solver wrapper that keeps the last problem and its solution.

    ``problem`` is the controller's own: the next cycle overwrites it.
    """

    problem: Problem
    result: Result

    def __init__(self, solver: Solver) -> None:
        """Wrap ``solver``."""
        self.solver = solver
        self.set_up = solver.set_up

    def solve(self, problem: Problem, shift: float, *, last: bool = True) -> Result:
        """Keep the problem and its solution, and return that.

        Parameters
        ----------
        problem, shift, last : as in ``Solver``.
        """
        self.problem = problem
        self.result = self.solver.solve(problem, shift, last=last)
        return self.result


class QpRecorder:
    """Solver factory that gives the QP of the newest cycle on request, and keeps the last one that was not solved."""

    def __init__(self, make_solver: SolverFactory = make) -> None:
        """Wrap the solvers that ``make_solver`` makes."""
        self._make_solver = make_solver
        self._newest: _NamingSolver | None = None
        self.failed: NamedQp | None = None
        """The last QP that was not solved, if there was one."""

    def __call__(self, vehicle: Vehicle, config: ControllerConfig) -> Solver:
        """Return a solver for these settings."""
        return _NamingSolver(self._make_solver(vehicle, config), self, scales(vehicle))

    def newest(self) -> NamedQp | None:
        """Return the QP that was solved last, with the names of its rows: until the next cycle that of the plan.

        None before the first cycle that has one.
        """
        return None if self._newest is None else self._newest.named()

    def add(self, solver: _NamingSolver) -> None:
        """Note the solver of the newest QP, and the QP if it was not solved.

        Parameters
        ----------
        solver : wrapped solver that has just solved it, or has failed.
        """
        self._newest = solver
        if solver.result.solve.status is not SolveStatus.SOLVED:
            with contextlib.suppress(Exception):  # a problem that cannot be laid out must not cost the cycle
                self.failed = solver.named()


class _NamingSolver(RecordingSolver):
    """Solver wrapper that reports each solve to its recorder."""

    def __init__(self, solver: Solver, recorder: QpRecorder, scale: Array) -> None:
        super().__init__(solver)
        self._recorder, self._scale = recorder, scale

    def solve(self, problem: Problem, shift: float, *, last: bool = True) -> Result:
        """Solve, and report it."""
        result = super().solve(problem, shift, last=last)
        self._recorder.add(self)
        return result

    def named(self) -> NamedQp:
        """Return the last problem as a QP with the names of its rows."""
        layout = SparseLayout(self.problem)
        qp = layout.assemble(layout.filled(self.problem))
        return NamedQp(qp, row_names(layout, self._scale), self.result.solve)
