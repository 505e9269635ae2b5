"""PIQP through its own interface: the reference of every measured time ratio (``ltv-mpc profile``, ``make bench``).

PIQP is an interior-point method (Schwan et al. 2023). Its workspace is updated in place, with its default settings. Box
rows are bounds on single variables. It needs no first guess and can use none. No setting of the controller leads here:
``solver = "piqp"`` is PIQP through qpsolvers.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import piqp
from scipy.sparse import csc_matrix

from ltv_mpc.control.config import ResolvedConfig
from ltv_mpc.control.horizon_limits import HorizonLimits
from ltv_mpc.control.linearisation import Linearisation
from ltv_mpc.control.qp.sparse import STAGE_VARIABLES, SparseQp, fill
from ltv_mpc.control.solvers.interface import SolverResult
from ltv_mpc.messages import Array, Solve, SolveStatus
from ltv_mpc.vehicle.flow import STATES


class PiqpYardstick:
    """PIQP workspace for problems of one sparsity pattern."""

    def __init__(self, config: ResolvedConfig, limits: HorizonLimits, tolerance: float | None = None) -> None:
        """Lay out the QP. ``tolerance`` is absolute and relative; None: PIQP's own."""
        self.form = form = SparseQp(config.knots, limits, config.weights)
        self._tolerance = tolerance
        self._numbers = form.allocate()
        row_of = form.pattern.indices
        E, slews, boxes = form.equalities + 2 * form.stages * np.arange(3)
        # Rows of A by kind, and where their numbers lie in A's. Those of limited states change as little as slew's.
        self._equal = row_of < E
        fixed = np.concatenate([np.arange(E, slews), np.arange(boxes, form.rows)])
        self._kinds = np.arange(E), fixed, np.arange(slews, boxes)
        thrusts = np.arange(form.stages)[:, None] * STAGE_VARIABLES + STATES + np.arange(2)
        self._thrusts = thrusts.ravel()
        self._low, self._high = np.full(form.variables, -np.inf), np.full(form.variables, np.inf)
        self._lin: Linearisation | None = None
        self._solver: Any = None
        self._finite = False

    def shift_warm_start(self, stages: float) -> None:
        """Do nothing: PIQP has no warm start."""

    def reset_warm_start(self) -> None:
        """Do nothing: PIQP has no warm start."""

    def build(self, lin: Linearisation, target: Array) -> None:
        """Build the QP (see ``Solver``)."""
        self._lin = lin
        fill(self.form.packed, lin, target, self.form.entries, self._numbers)
        self._finite = bool(np.isfinite(sum(part.sum() for part in self._numbers)))

    def update(self) -> None:
        """Update the workspace (see ``Solver``)."""
        if not self._finite:
            return
        A, q, l, u = self._numbers  # noqa: E741
        equal, slew, box = self._kinds
        self._low[self._thrusts], self._high[self._thrusts] = l[box], u[box]
        if self._solver is None:
            whole = csc_matrix(self.form.assemble(self._numbers).A)
            self._equalities, self._slews = csc_matrix(whole[equal]), csc_matrix(whole[slew])
            self._P = csc_matrix(self.form.P)
            self._solver = piqp.SparseSolver()
            self._solver.settings.verbose = False
            if self._tolerance is not None:
                to = self._solver.settings
                to.eps_abs = to.eps_rel = self._tolerance
                to.eps_duality_gap_abs = to.eps_duality_gap_rel = self._tolerance
            self._solver.setup(
                self._P, q, self._equalities, l[equal], self._slews, l[slew], u[slew],
                self._low, self._high,
            )  # fmt: skip
        else:
            self._equalities.data[:] = A[self._equal]
            self._solver.update(
                c=q, A=self._equalities, b=l[equal], h_l=l[slew], h_u=u[slew],
                x_l=self._low, x_u=self._high,
            )  # fmt: skip

    def solve(self) -> SolverResult:
        """Solve the QP (see ``Solver``)."""
        lin = self._lin
        assert lin is not None  # built
        if not self._finite or self._solver is None:
            return SolverResult(lin.U.copy(), Solve(status=SolveStatus.NON_FINITE, why="the problem is not finite"))
        status = self._solver.solve()
        x, info = self._solver.result.x, self._solver.result.info
        if not np.isfinite(x).all():
            self._solver = None
            return SolverResult(
                lin.U.copy(),
                Solve(status=SolveStatus.NON_FINITE, why="PIQP returned a value that is not finite; rebuilt"),
            )
        code = piqp.Status
        known = {
            code.PIQP_SOLVED: SolveStatus.SOLVED,
            code.PIQP_MAX_ITER_REACHED: SolveStatus.ITERATION_LIMIT,
            code.PIQP_PRIMAL_INFEASIBLE: SolveStatus.INFEASIBLE,
            code.PIQP_DUAL_INFEASIBLE: SolveStatus.INFEASIBLE,
        }.get(status, SolveStatus.FAILED)
        solve = Solve(
            status=known,
            iterations=int(info.iter),
            primal_residual=float(info.primal_res),
            dual_residual=float(info.dual_res),
            why="" if known is SolveStatus.SOLVED else f"PIQP: {status}",
        )
        return SolverResult(self.form.commands(lin, np.array(x)), solve)
