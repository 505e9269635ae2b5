"""DAQP on the condensed QP: a dual active-set method, exact up to rounding, updated in place.

Each solve begins with the working set that the last one ended with. Shifting that set along with the plan was tried: at
17 stages it takes as many iterations in nine cycles of ten and more in the worst, at 68 fewer and twice as many in the
worst, where the time goes into the factorisation all the same. So the set stays where it is.

An active-set method ends at the optimum or not at all, so there are no residuals to report; ``tolerance`` is not read.
"""

from __future__ import annotations

import numpy as np
from daqp import Model

from ltv_mpc.control.config import SettledConfig
from ltv_mpc.control.horizon import Linearisation, not_finite
from ltv_mpc.control.limits import HorizonLimits
from ltv_mpc.control.qp.condensed import CondensedForm
from ltv_mpc.control.qp.problem import QP
from ltv_mpc.control.qp.rows import Row
from ltv_mpc.control.solvers.solver import Answer
from ltv_mpc.messages import Array, Solve, SolveStatus

VIOLATION = 1e-9
"""By how much a bound may be violated, as a part of the thrusters' limit."""

ITERATIONS = 10
"""Most changes of the working set, for each bound there is: none of the cold starts seen took one."""

_OPTIMAL, _SOFT = 1, 2
_STATUS = {
    _OPTIMAL: SolveStatus.SOLVED,
    _SOFT: SolveStatus.SOLVED,
    -1: SolveStatus.INFEASIBLE,
    -4: SolveStatus.ITERATION_LIMIT,
}
_WORDS = {
    -1: "infeasible",
    -2: "the working set repeats itself",
    -3: "unbounded",
    -4: "iteration limit",
    -5: "the cost is not convex",
    -6: "the first working set is overdetermined",
}


class CondensedDaqp:
    """The problem with its states eliminated, and DAQP's workspace for it."""

    def __init__(self, config: SettledConfig, limits: HorizonLimits) -> None:
        """``config`` says how many stages, and the weights."""
        self._form = CondensedForm(config.knots, limits, config.weights)
        self._cold = np.zeros(len(self._form.lower), dtype=np.int32)  # no bound in the working set
        self._model: Model | None = None
        self._warm = False
        self._why = ""
        self._lin: Linearisation | None = None

    def shift(self, stages: float) -> None:
        """The working set stays where it is."""

    def forget(self) -> None:
        """The next solve begins with an empty working set."""
        self._warm = False

    def build(self, lin: Linearisation, target: Array) -> None:
        """H, f and the bounds of one cycle; ``target`` (N+1, 2) as in ``Solver``."""
        finite = self._form.build(lin, target)
        self._lin = lin
        self._why = "" if finite else not_finite(lin, target)

    def update(self) -> None:
        """Into DAQP, which factorises H and transforms the slew rows."""
        if self._why:  # one NaN would stay in the workspace
            return
        form = self._form
        if self._model is None:
            self._model = Model()
            self._model.setup(form.H, form.f, form.A, form.upper, form.lower, self._cold)
            self._model.settings = {"primal_tol": VIOLATION, "iter_limit": ITERATIONS * len(form.lower)}
        elif self._warm:
            self._model.update(H=form.H, f=form.f, bupper=form.upper, blower=form.lower)
        else:
            self._model.update(H=form.H, f=form.f, bupper=form.upper, blower=form.lower, sense=self._cold)

    def solve(self) -> Answer:
        """Solve what was built and loaded; the previous commands where there is no answer."""
        assert self._lin is not None, "nothing was built"
        if self._why or self._model is None:
            self.forget()
            return self._nothing(SolveStatus.NON_FINITE, self._why)
        z, _, flag, info = self._model.solve()
        iterations = int(info["iterations"])
        if flag < 0 and self._warm:
            # The set that was optimal for the last problem may not be a possible one for this: once more from nothing.
            self.forget()
            self.update()
            z, _, flag, info = self._model.solve()
            iterations += int(info["iterations"])
        commands, finite = self._form.commands(self._lin, z)
        if flag < 0:
            self._model = None
            self.forget()
            words = _WORDS.get(flag, f"flag {flag}")
            return self._nothing(_STATUS.get(flag, SolveStatus.FAILED), f"DAQP: {words} after {iterations} iterations")
        if not finite:
            self._model = None
            self.forget()
            return self._nothing(SolveStatus.NON_FINITE, "DAQP returned a value that is not finite; rebuilt")
        self._warm = True
        return Answer(commands, Solve(status=SolveStatus.SOLVED, iterations=iterations))

    def rows(self) -> tuple[Row, ...]:
        """As in ``Solver``."""
        return self._form.row_names

    def problem(self) -> QP:
        """The condensed QP last built: bounds of the commands first, then the slew rows."""
        return self._form.problem()

    def _nothing(self, status: SolveStatus, why: str) -> Answer:
        assert self._lin is not None
        return Answer(self._lin.U.copy(), Solve(status=status, why=why))
