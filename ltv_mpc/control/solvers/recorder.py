"""Solver wrappers that keep what a solver was given and what it returned: for tools and tests, and for failed QPs."""

from __future__ import annotations

import contextlib

from ltv_mpc.control.config import STAGE_NS, ControllerConfig
from ltv_mpc.control.failed_qp import FailedQp, row_names
from ltv_mpc.control.horizon_limits import HorizonLimits
from ltv_mpc.control.ocp.assembly import scales
from ltv_mpc.control.ocp.problem import Problem
from ltv_mpc.control.solvers import SolverFactory, make
from ltv_mpc.control.solvers.interface import Result, Solver
from ltv_mpc.control.solvers.sparse import SparseLayout
from ltv_mpc.messages import SolveStatus
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
        self.shift_warm_start = solver.shift_warm_start
        self.reset_warm_start = solver.reset_warm_start
        self.update = solver.update
        self.draft = getattr(solver, "draft", None)

    def build(self, problem: Problem) -> None:
        """Keep the problem.

        Parameters
        ----------
        problem : as in ``Solver.build``.
        """
        self.problem = problem
        self.solver.build(problem)

    def solve(self) -> Result:
        """Keep the solution, and return it."""
        self.result = self.solver.solve()
        return self.result


class FailureRecorder:
    """Solver factory whose solvers keep the last QP that was not solved."""

    def __init__(self, make_solver: SolverFactory = make) -> None:
        """Wrap the solvers that ``make_solver`` makes."""
        self._make_solver = make_solver
        self.failed: FailedQp | None = None
        """The last QP that was not solved, if there was one."""

    def __call__(self, vehicle: Vehicle, config: ControllerConfig) -> Solver:
        """Return a solver for these settings."""
        limits = HorizonLimits.from_vehicle(vehicle, STAGE_NS * 1e-9)
        solver = _FailureRecordingSolver(self._make_solver(vehicle, config))
        solver.recorder, solver.limits = self, limits
        return solver


class _FailureRecordingSolver(RecordingSolver):
    """Solver wrapper that reports each problem that was not solved."""

    recorder: FailureRecorder
    limits: HorizonLimits

    def solve(self) -> Result:
        """Solve, and keep the QP if it was not solved."""
        result = super().solve()
        if result.solve.status is not SolveStatus.SOLVED:
            with contextlib.suppress(Exception):  # a problem that cannot be laid out must not cost the cycle
                layout = SparseLayout(self.problem)
                qp = layout.assemble(layout.filled(self.problem))
                self.recorder.failed = FailedQp(qp, row_names(layout, scales(self.limits)), result.solve)
        return result
