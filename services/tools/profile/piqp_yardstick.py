"""PIQP through its own interface: the reference of every measured time ratio (``ltv-mpc profile``, ``make bench``).

PIQP is an interior-point method (Schwan et al. 2023). Its workspace is updated in place, with its default settings.
Hard rows are bounds on single variables. It needs no first guess and can use none. No setting of the controller leads
here: ``solver = "piqp"`` is PIQP through qpsolvers.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import piqp
from scipy.sparse import csc_matrix

from ltv_mpc.control.ocp.problem import Problem
from ltv_mpc.control.solvers.interface import Result
from ltv_mpc.control.solvers.sparse import DYNAMICS, HARD, SparseLayout, fill, fits, solution_of
from ltv_mpc.messages import Solve, SolveStatus


class PiqpYardstick:
    """PIQP workspace for problems of one sparsity pattern."""

    def __init__(self, tolerance: float | None = None) -> None:
        """Set nothing up. ``tolerance`` is absolute and relative; None: PIQP's own."""
        self._tolerance = tolerance
        self._layout: SparseLayout | None = None
        self._solver: Any = None

    def set_up(self, problem: Problem) -> None:
        """Lay out the QP of a problem, and of those before it (see ``Solver``)."""
        layout = SparseLayout(problem, self._layout)
        self._layout, self._numbers, self._solver = layout, layout.allocate(), None
        kind, row_of = layout.places.kind, layout.A.indices
        self._equal, self._bound = np.flatnonzero(kind == DYNAMICS), np.flatnonzero(kind == HARD)
        self._other = np.flatnonzero((kind != DYNAMICS) & (kind != HARD))
        self._equal_entries, self._other_entries = np.isin(row_of, self._equal), np.isin(row_of, self._other)
        column_of = np.repeat(np.arange(layout.variables), np.diff(layout.A.indptr))
        variable = np.zeros(layout.rows, dtype=np.int64)
        variable[row_of] = column_of  # a hard row has one entry
        self._bounded = variable[self._bound]
        self._low, self._high = np.full(layout.variables, -np.inf), np.full(layout.variables, np.inf)

    def _update(self, layout: SparseLayout) -> None:
        """Pass the numbers to the workspace."""
        P, q, A, l, u = self._numbers  # noqa: E741
        self._low[self._bounded], self._high[self._bounded] = l[self._bound], u[self._bound]
        bounds = {"x_l": self._low, "x_u": self._high, "h_l": l[self._other], "h_u": u[self._other]}
        if self._solver is None:
            pattern, whole = layout.P, csc_matrix((A, layout.A.indices, layout.A.indptr), layout.A.shape)
            self._P = csc_matrix((P.copy(), pattern.indices, pattern.indptr), pattern.shape)  # PIQP reads this half
            self._A, self._G = csc_matrix(whole[self._equal]), csc_matrix(whole[self._other])
            self._solver = piqp.SparseSolver()
            self._solver.settings.verbose = False
            if self._tolerance is not None:
                to = self._solver.settings
                to.eps_abs = to.eps_rel = self._tolerance
                to.eps_duality_gap_abs = to.eps_duality_gap_rel = self._tolerance
            self._solver.setup(P=self._P, c=q, A=self._A, b=l[self._equal], G=self._G, **bounds)
        else:
            self._P.data[:], self._A.data[:], self._G.data[:] = P, A[self._equal_entries], A[self._other_entries]
            self._solver.update(P=self._P, c=q, A=self._A, b=l[self._equal], G=self._G, **bounds)

    def solve(self, problem: Problem, shift: float, *, last: bool = True) -> Result:  # noqa: ARG002
        """Solve the QP (see ``Solver``)."""
        p = problem
        if self._layout is None or not fits(p, self._layout.masks):
            self.set_up(p)
        assert self._layout is not None
        fill(p, self._layout.places, self._numbers)
        self._update(self._layout)
        status = self._solver.solve()
        x, info = self._solver.result.x, self._solver.result.info
        if not np.isfinite(x).all():
            why = "PIQP returned a value that is not finite"
            return Result(np.zeros_like(p.h), Solve(status=SolveStatus.NON_FINITE, why=why))
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
        return Result(solution_of(p, np.array(x)), solve)
