"""OSQP on the partially condensed QP, each row with a step size of its own.

OSQP has one step size rho for all rows; a row multiplied by s has rho s^2. So the rows are scaled here: the dynamics by
DYNAMICS, box and slew rows by what ``Round`` says of free rows and of binding ones, those whose dual is not zero. Which
duals those are is taken from the first guess, and after each round from the iterates: A changes each cycle anyway, so
its factorisation is paid for. OSQP's own scaling and step adaptation are off; its residuals, and the tolerance, are
those of the scaled rows.

The first guess is what the sweeps along the stages come to from the shifted last duals (``stagewise.py``), with the
states at the blocks' ends and the costates that belong to it: mostly the solution, which one iteration then confirms.
"""

from __future__ import annotations

from itertools import chain, cycle
from typing import NamedTuple

import numpy as np

from ltv_mpc.compiled import kernel
from ltv_mpc.control import grid
from ltv_mpc.control.config import SettledConfig
from ltv_mpc.control.constants import objective
from ltv_mpc.control.horizon import Linearisation, not_finite, views
from ltv_mpc.control.limits import HorizonLimits
from ltv_mpc.control.qp.condensed import commands
from ltv_mpc.control.qp.partial import BLOCK, Indices, PartialForm, fill_A
from ltv_mpc.control.qp.problem import QP
from ltv_mpc.control.qp.rows import Row
from ltv_mpc.control.qp.sweeps import ROWS
from ltv_mpc.control.solvers import stagewise
from ltv_mpc.control.solvers.osqp_raw import PLAIN, Account, Workspace, workspace
from ltv_mpc.control.solvers.solver import Answer
from ltv_mpc.messages import Array, Solve, SolveStatus
from ltv_mpc.vehicle.flow import STATES

DYNAMICS = 100.0
"""Row scale of the dynamics: the root of their step size."""


class Round(NamedTuple):
    """Iterations with the same step sizes: the row scales of free and of binding rows."""

    iterations: int
    free: float
    binding: float


FIRST = Round(6, 0.002, 0.1)
"""Where the active rows are as predicted, a free row is to have no effect at all: far below the cost's least curvature,
which is the weight on thrust."""

LATER = (Round(24, 0.02, 0.1), Round(24, 0.05, 0.3), Round(24, 0.1, 1.0))
"""Taken in turn where they were not: a free row is to be felt, and large duals want large steps."""

GRADIENT = 1.0
"""Largest entry of q up to which these are the scales; beyond, duals grow with q, and the step sizes with them."""

VIOLATION = 2e-4
"""By how much box and slew may be violated, as a part of the thrusters' limit: a row that was held to be free has a
scale, and so a residual, too small to tell."""

CHECK = 1
"""Iterations between two looks at the residuals: the first is mostly the last."""


RELAXATION = 1.0
"""None: with step sizes that fit, OSQP's 1.6 leaves 0.6 of each iteration's error."""


class PartialOsqp:
    """One OSQP workspace for the partially condensed problem."""

    def __init__(self, config: SettledConfig, limits: HorizonLimits, *, block: int = BLOCK) -> None:
        """``config`` says how many stages, the weights, the tolerance and the most iterations."""
        form = self._form = PartialForm(config.knots, limits, config.weights, block)
        self._knots = config.knots
        self._tolerance, self._most = config.tolerance, config.max_iterations
        self._solver: Workspace | None = None
        self._dual = np.zeros(form.rows)  # of the rows as they are
        self._row_scale = np.ones(form.rows)
        self._row_scale[: form.states] = DYNAMICS
        self._x, self._y = np.zeros(form.variables), np.zeros(form.rows)  # the first guess, y of scaled rows
        self._A = np.zeros(form.entries)
        self._lower, self._upper = np.zeros(form.rows), np.zeros(form.rows)
        self._why = ""
        self._lin: Linearisation | None = None

    def shift(self, stages: float) -> None:
        """Duals of box and slew move with the plan, the last ones stay."""
        _shift(self._dual, self._form.states, self._knots, stages)

    def forget(self) -> None:
        """The next solve begins with no active row."""
        self._dual[:] = 0.0

    def build(self, lin: Linearisation, target: Array) -> None:
        """The numbers of one cycle; ``target`` (N+1, 2) as in ``Solver``."""
        form = self._form
        finite = form.build(lin, target)
        self._lin = lin
        self._why = "" if finite else not_finite(lin, target)
        if finite:
            of_blocks = (form.ends, form.cost, form.end_cost, form.motion)
            _guess(lin.flat, target, form.numbers, *of_blocks, self._x, self._dual)

    def update(self) -> None:
        """Into OSQP, which factorises."""
        if self._why:  # one NaN would stay in the workspace
            return
        form = self._form
        self._scale_rows(FIRST)
        if self._solver is None:
            P, A = form.matrices(self._A)
            settings = {
                **PLAIN,
                "max_iter": FIRST.iterations,
                "eps_abs": self._tolerance,
                "check_termination": CHECK,
                "alpha": RELAXATION,
            }
            self._solver = workspace(P, form.q, A, self._lower, self._upper, settings)
        else:
            self._solver.update_vectors(form.q, self._lower, self._upper)
            self._solver.update_matrices(self._A, form.P)

    def solve(self) -> Answer:
        """Rounds of iterations until the residuals are below the tolerance."""
        assert self._lin is not None, "nothing was built"
        if self._why or self._solver is None:
            self.forget()
            return self._nothing(Solve(status=SolveStatus.NON_FINITE, why=self._why))
        form, solver = self._form, self._solver
        x, iterations = self._x, 0
        for turn in chain([FIRST], cycle(LATER)):
            if iterations:
                self._scale_rows(turn)
                solver.update_vectors(form.q, self._lower, self._upper)
                solver.update_matrices(self._A)
            solver.limit(turn.iterations, self._tolerance)
            solver.warm_start(x, self._y)
            status = solver.solve()
            x, y = solver.read()
            account = solver.account()
            iterations += account.iterations
            finite, violation, planned = _read(
                x, y, self._row_scale, form.lower, form.upper, self._lin.U, form.thrust_scale, self._dual
            )
            again = status is SolveStatus.ITERATION_LIMIT or (status is SolveStatus.SOLVED and violation > VIOLATION)
            if not again or iterations >= self._most or not finite:
                break
        if not finite:
            self._solver = None
            self.forget()
            why = "OSQP returned a value that is not finite; rebuilt"
            return self._nothing(Solve(status=SolveStatus.NON_FINITE, iterations=iterations, why=why))
        if violation > VIOLATION:
            status = SolveStatus.ITERATION_LIMIT
        return Answer(planned, _said(status, iterations, account, violation))

    def _scale_rows(self, turn: Round) -> None:
        form = self._form
        _scale_rows(
            self._dual,
            form.states,
            form.lower,
            form.upper,
            form.q,
            turn.free,
            turn.binding,
            turn is FIRST,
            self._row_scale,
            self._y,
            self._lower,
            self._upper,
            form.motion,
            form.A_from,
            form.A_row,
            self._A,
        )

    def rows(self) -> tuple[Row, ...]:
        """As in ``Solver``."""
        return self._form.row_names

    def problem(self) -> QP:
        """The partially condensed QP last built, its rows not scaled."""
        return self._form.problem()

    def _nothing(self, solve: Solve) -> Answer:
        assert self._lin is not None
        return Answer(self._lin.U.copy(), solve)


def _said(status: SolveStatus, iterations: int, account: Account, violation: float) -> Solve:
    why = ""
    if status is not SolveStatus.SOLVED:
        residuals = f"primal residual {account.primal_residual:.1e}, dual {account.dual_residual:.1e}"
        residuals += f", box or slew violated by {violation:.1e} of the largest thrust"
        why = f"OSQP: {status.value} after {iterations} iterations, {residuals}"
    return Solve(
        status=status,
        iterations=iterations,
        primal_residual=account.primal_residual,
        dual_residual=account.dual_residual,
        why=why,
    )


@kernel
def _scale_rows(
    dual: Array,
    states: int,
    lower: Array,
    upper: Array,
    q: Array,
    free: float,
    binding: float,
    predicted: bool,
    scale: Array,
    y: Array,
    scaled_lower: Array,
    scaled_upper: Array,
    motion: Array,
    A_from: Indices,
    A_row: Indices,
    A: Array,
) -> None:
    """Scale, dual and bounds of the scaled rows, (m,) each, and A's stored entries, in place.

    The dynamics' bounds are zero and stay so.
    """
    steepest = GRADIENT
    for i in range(states, q.shape[0]):
        steepest = max(steepest, abs(q[i]))
    larger = np.sqrt(steepest / GRADIENT)
    binding *= larger
    if not predicted:
        free *= larger
    for i in range(states):
        y[i] = dual[i] / scale[i]
    for i in range(states, dual.shape[0]):
        scale[i] = binding if dual[i] != 0.0 else free
        scaled_lower[i] = scale[i] * lower[i - states]
        scaled_upper[i] = scale[i] * upper[i - states]
        y[i] = dual[i] / scale[i]
    fill_A(motion, A_from, A_row, scale, A)


@kernel
def _read(
    x: Array, y: Array, scale: Array, lower: Array, upper: Array, U: Array, thrust: Array, dual: Array
) -> tuple[bool, float, Array]:
    """Whether x (n,) and y (m,) are finite, by how much z is outside of box or slew, and the commands (N+1, 2).

    The rows' duals in place.
    """
    total = x.sum()
    for i in range(y.shape[0]):
        dual[i] = y[i] * scale[i]
        total += dual[i]
    states = y.shape[0] - lower.shape[0]
    n = x.shape[0] - states
    worst = 0.0
    for i in range(n):
        z = x[states + i]
        worst = max(worst, lower[i] - z, z - upper[i])
        if i >= 2:
            change = z - x[states + i - 2]
            worst = max(worst, lower[n + i - 2] - change, change - upper[n + i - 2])
    planned, finite = commands(U, x[states:], thrust)
    return finite and bool(np.isfinite(total)), worst, planned


@kernel
def _shift(dual: Array, states: int, t: Array, stages: float) -> None:
    """Duals (m,) for knots t (N+1,) that begin ``stages`` later, linear between knots, in place.

    The bound of z_1 is box and slew in one: its dual is that of both. The dynamics' duals become zero.
    """
    N = len(t) - 1
    box, slew = np.zeros((N, 2)), np.zeros((N, 2))
    for k in range(N):
        for i in range(2):
            box[k, i] = dual[states + 2 * k + i]
            if k > 0:
                slew[k, i] = dual[states + 2 * N + 2 * k - 2 + i]
    grid.shift(box, t, stages)
    grid.shift(slew, t, stages)
    dual[:] = 0.0
    for k in range(N):
        for i in range(2):
            if k == 0:
                dual[states + i] = box[k, i] + slew[k, i]
            else:
                dual[states + 2 * k + i] = box[k, i]
                dual[states + 2 * N + 2 * k - 2 + i] = slew[k, i]


@kernel
def _guess(
    flat: Array,
    target: Array,
    numbers: Array,
    ends: Indices,
    cost: Array,
    end: Array,
    motion: Array,
    x: Array,
    dual: Array,
) -> None:
    """x (n,) and the rows' duals (m,) to begin with, in place; those of the limits come in shifted."""
    N, last = len(target) - 1, len(ends) - 2
    lin, o = views(flat, N), objective(numbers)
    states = STATES * (last + 1)
    slew = states + 2 * N - 2  # that of knot 1 would stand here: it is part of the bound of z_1
    y, dU = np.zeros((N, ROWS)), np.zeros((N + 1, 2))
    for k in range(N):
        for i in range(2):
            y[k, i] = dual[states + 2 * k + i]
            if k > 0:
                y[k, 2 + i] = dual[slew + 2 * k + i]
    came_to, _, _ = stagewise.solve(lin, target, o, stagewise.MOST_SWEEPS, y, dU)
    x[:] = 0.0
    dual[:states] = 0.0
    if came_to == stagewise.NOTHING:
        return
    for k in range(N):
        for i in range(2):
            x[states + 2 * k + i] = dU[k + 1, i] / o.scale[i]
            dual[states + 2 * k + i] = y[k, i] + (y[k, 2 + i] if k == 0 else 0.0)
            if k > 0:
                dual[slew + 2 * k + i] = y[k, 2 + i]
    for b in range(last + 1):
        known = _of_block(x, states, ends, b)
        for i in range(STATES):
            total = 0.0
            for j in range(len(known)):
                total += motion[b, i, j] * known[j]
            x[b * STATES + i] = total
    # lambda_b = E_b x_b + (Q [x, z])_x + T_x' lambda of the block that begins there
    for b in range(last, -1, -1):
        known = _of_block(x, states, ends, b + 1) if b < last else np.zeros(0)
        for i in range(STATES):
            total = 0.0
            for j in range(STATES):
                total += end[b, i, j] * x[b * STATES + j]
                if b < last:
                    total += motion[b + 1, j, i] * dual[(b + 1) * STATES + j]
            for j in range(len(known) - 2):  # the last command acts on the end alone
                total += cost[b + 1, min(i, j), max(i, j)] * known[j]
            dual[b * STATES + i] = total


@kernel
def _of_block(x: Array, states: int, ends: Indices, b: int) -> Array:
    """[x_s, z_s, .., z_e] of a block; those of knot 0 are given: no deviation."""
    s, e = ends[b], ends[b + 1]
    known = np.zeros(STATES + 2 * (e - s + 1))
    if b > 0:
        known[:STATES] = x[(b - 1) * STATES : b * STATES]
    for k in range(max(s, 1), e + 1):
        for i in range(2):
            known[STATES + 2 * (k - s) + i] = x[states + 2 * (k - 1) + i]
    return known
