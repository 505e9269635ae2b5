"""Solver wrappers that keep what a solver was given and what it returned: for tools and tests, and for failed QPs."""

from __future__ import annotations

import contextlib
from functools import cached_property

from ltv_mpc.control.config import STAGE_NS, ControllerConfig, ResolvedConfig
from ltv_mpc.control.horizon_limits import HorizonLimits
from ltv_mpc.control.linearisation import Linearisation
from ltv_mpc.control.qp.failed_qp import FailedQp
from ltv_mpc.control.qp.sparse import SparseQp
from ltv_mpc.control.resolution import settled
from ltv_mpc.control.solvers import SolverFactory, make
from ltv_mpc.control.solvers.interface import Solver, SolverResult
from ltv_mpc.messages import Array, SolveStatus
from ltv_mpc.vehicle.parameters import Vehicle


class RecordingSolver:
    """Solver wrapper that keeps the last problem and its solution.

    ``lin`` is the controller's own array: the next cycle overwrites it.
    """

    lin: Linearisation
    target: Array
    result: SolverResult

    def __init__(self, solver: Solver) -> None:
        """Wrap ``solver``."""
        self.solver = solver
        self.shift_warm_start = solver.shift_warm_start
        self.reset_warm_start = solver.reset_warm_start
        self.update = solver.update

    def build(self, lin: Linearisation, target: Array) -> None:
        """Keep the problem.

        Parameters
        ----------
        lin, target : as in ``Solver.build``.
        """
        self.lin, self.target = lin, target
        self.solver.build(lin, target)

    def solve(self) -> SolverResult:
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
        return _FailureRecordingSolver(self._make_solver(vehicle, config), vehicle, config, self)


class _FailureRecordingSolver(RecordingSolver):
    """Solver wrapper that reports each problem that was not solved."""

    def __init__(self, solver: Solver, vehicle: Vehicle, config: ControllerConfig, recorder: FailureRecorder) -> None:
        super().__init__(solver)
        self._vehicle = vehicle
        self._config: ResolvedConfig = settled(config, vehicle)
        self._recorder = recorder

    def solve(self) -> SolverResult:
        """Solve, and keep the QP if it was not solved."""
        result = super().solve()
        if result.solve.status is not SolveStatus.SOLVED:
            with contextlib.suppress(Exception):  # a problem that cannot be laid out must not cost the cycle
                layout = self._layout
                self._recorder.failed = FailedQp(layout.build(self.lin, self.target), layout.row_names, result.solve)
        return result

    @cached_property
    def _layout(self) -> SparseQp:
        limits = HorizonLimits.from_vehicle(self._vehicle, STAGE_NS * 1e-9, self._config.limits.state_bounds)
        return SparseQp(self._config.knots, limits, self._config.weights)
