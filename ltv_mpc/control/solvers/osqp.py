"""OSQP on the sparse QP: one workspace, updated in place, with a step size for each kind of row.

OSQP's method (Stellato et al. 2020) is the alternating direction method of multipliers with one step size rho. One is
wrong for two of three kinds of row: the dynamics want 1e4 to 1e7 times that of box and slew, and a limit that is active
100 times that of one that is not. A row multiplied by s acts as if its step size were rho s^2, so the rows are scaled
and rho stays 1. Which limits are active is known before the solve from the previous one's duals, and looked at again
after each turn of some iterations: where it has changed the rows are scaled anew. A's numbers change in every cycle
anyway, so the factorisation is paid already.

The first guess: commands and duals of box and slew from sweeps along the stages (``riccati_solver.py``), which
nearly always
are the solution's; the states that they lead to, gaps closed, by a sweep forward, the duals of the dynamics (costates)
by one backward. What is left for OSQP is to say so, after one iteration. Where the sweeps do not apply (an active limit
of the motion, a cost without a weight on thrust) the guess is the trajectory that was linearised along, with the duals
of the previous solve.

The over-relaxation is off: with step sizes this unequal the plain iteration is the faster one.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ltv_mpc.control import shooting_grid
from ltv_mpc.control.config import ResolvedConfig
from ltv_mpc.control.horizon_limits import LIMITED_STATES, HorizonLimits
from ltv_mpc.control.linearisation import (
    Linearisation,
    describe_non_finite,
    multiply_A,
    multiply_A_transposed,
    velocity_over_ground,
    views,
)
from ltv_mpc.control.problem_data import Objective, limited_state_count, stage_length, state_scale, unpack_objective
from ltv_mpc.control.qp.failed_qp import worst_violation
from ltv_mpc.control.qp.problem import QP
from ltv_mpc.control.qp.riccati import LIMIT_ROWS
from ltv_mpc.control.qp.sparse import STAGE_VARIABLES, Indices, SparseQp, fill, unpack_map
from ltv_mpc.control.solvers import riccati_solver
from ltv_mpc.control.solvers.interface import SolverResult
from ltv_mpc.control.solvers.osqp_workspace import BASE_SETTINGS, Settings, Workspace, make_workspace
from ltv_mpc.jit import copy_to, jit
from ltv_mpc.messages import Array, Solve, SolveStatus
from ltv_mpc.vehicle.flow import STATES

EQUALITY_ROW = 300.0
"""s of the dynamics: their step size is its square."""

LIMIT_ROW = 0.015
"""s of box and slew rows that are not active, where the gradient is small."""

GRADIENT = 0.5
"""Largest entry of q up to which LIMIT_ROW holds; beyond, duals grow with q, and the step size with them."""

MAX_LIMIT_ROW = 0.2

MAX_LOOSENING = 5.0
"""By how much the tolerance grows with the duals, at most."""

ACTIVE = 10.0
"""By how much more rows of active limits are scaled."""

MOTION_ROW, MOTION_ACTIVE, EXCESS_ROW = 0.05, 1.5, 15.0
"""s of the limits of a state, not active and active, and of its excess, while the gradient is small."""

NOT_ACTIVE = 1e-9
"""A dual below this is what rounding left of none."""

FIRST_BATCH = 1
"""Iterations until OSQP first looks at its residuals: the guess mostly is the solution."""

BATCH = 9
"""Iterations between two looks at the active limits."""

CONSTANT_BATCHES = 6
"""Turns until each is twice as long as the one before: with its rows left alone, OSQP converges always."""

CHECK = 3
"""Iterations between two looks at the residuals."""


class SolveArrays(NamedTuple):
    """The numbers of one solve, in one array."""

    A: Array  # (nnz,) of the problem
    q: Array  # (n,)
    l: Array  # noqa: E741  (m,)
    u: Array
    x: Array  # (n,) primal and dual: of the last solve, or the first guess of the next
    y: Array
    rows: Array  # (m,) by what each row is multiplied
    As: Array  # the same with scaled rows
    ls: Array
    us: Array
    ys: Array


@jit
def unpack_arrays(flat: Array, N: int, limited: int) -> SolveArrays:
    """The parts of a flat array for N stages and so many limited states."""
    n, m = N * (STAGE_VARIABLES + limited) + 2, N * (STATES + 4 + 3 * limited) + 2
    e = (len(flat) - 2 * n - 7 * m) // 2
    q = e
    l = q + n  # noqa: E741
    x = l + 2 * m
    y = x + n
    As = y + 2 * m
    ls = As + e
    return SolveArrays(
        flat[:q],
        flat[q:l],
        flat[l : l + m],
        flat[l + m : x],
        flat[x:y],
        flat[y : y + m],
        flat[y + m : As],
        flat[As:ls],
        flat[ls : ls + m],
        flat[ls + m : ls + 2 * m],
        flat[ls + 2 * m :],
    )


class OsqpSolver:
    """The default solver."""

    def __init__(self, config: ResolvedConfig, limits: HorizonLimits) -> None:
        """``config.tolerance`` is absolute, on the residuals of the scaled problem."""
        self.form = form = SparseQp(config.knots, limits, config.weights)
        self._most = config.max_iterations
        self._tolerance = self._eps = config.tolerance
        entries = form.pattern.nnz
        self._flat = np.zeros(2 * entries + 2 * form.variables + 7 * form.rows)
        self._arrays: SolveArrays = unpack_arrays(self._flat, form.stages, len(form.limited))
        self._arrays.A[:] = form.template()
        self._shift = math.nan
        self._finite, self._why = False, "build() must be called before solve()"
        self._lin: Linearisation | None = None
        self._workspace: Workspace | None = None

    def shift_warm_start(self, stages: float) -> None:
        """As in ``Solver``."""
        self._shift = stages

    def reset_warm_start(self) -> None:
        """As in ``Solver``."""
        self._shift = math.nan

    def build(self, lin: Linearisation, target: Array) -> None:
        """As in ``Solver``."""
        self._lin, form = lin, self.form
        size = prepare(form.numbers, lin.flat, target, form.map, form.factor, self._shift, self._flat)
        self._finite = size >= 0.0
        self._why = "" if self._finite else describe_non_finite(lin, target)
        self._eps = self._tolerance * min(size, MAX_LOOSENING)

    def update(self) -> None:
        """As in ``Solver``."""
        if not self._finite:  # one NaN would poison the workspace for every later solve
            return
        if self._workspace is None:
            at = self._arrays
            # Nothing new yet, but compiled: it may not be called again before the first hard problem.
            rescale(self.form.map, self._flat, self.form.stages, len(self.form.limited))
            of, settings = self.scaled_problem()
            self._workspace = make_workspace(of.P, of.q, of.A, of.l, of.u, settings)
            self._workspace.warm_start(at.x, at.ys)
        else:
            self._load(self._workspace)

    def _load(self, solver: Workspace) -> None:
        at = self._arrays
        solver.update_matrix(at.As)
        solver.update_vectors(at.q, at.ls, at.us)
        solver.warm_start(at.x, at.ys)

    def solve(self) -> SolverResult:
        """As in ``Solver``. Ends after ``max_iterations`` or a few more, never by time."""
        lin, solver = self._lin, self._workspace
        assert lin is not None  # built
        if not self._finite or solver is None:
            return self._nothing(lin, self._why)
        commands = np.empty_like(lin.U)
        iterations, turn = 0, 0
        while True:
            length = BATCH * 2 ** max(0, turn - CONSTANT_BATCHES) if turn else FIRST_BATCH
            solver.set_limits(min(length, self._most), self._eps)
            turn += 1
            status = solver.solve()
            account = solver.statistics()
            iterations += account.iterations
            if not store_solution(self.form.numbers, *solver.solution(), lin.flat, self._flat, commands):
                self._workspace = None
                return self._nothing(lin, "OSQP returned a value that is not finite; rebuilt")
            if status is SolveStatus.SOLVED or iterations >= self._most:
                break
            if rescale(self.form.map, self._flat, self.form.stages, len(self.form.limited)) > 0:
                self._load(solver)
        self._shift = 0.0
        why = ""
        if status is not SolveStatus.SOLVED:
            residuals = f"primal residual {account.primal_residual:.1e}, dual {account.dual_residual:.1e}"
            why = f"OSQP: {status.value.replace('_', ' ')} after {iterations} iterations, {residuals}"
            violated = worst_violation(self.problem(), self._arrays.x, self.form.row_names)
            why += f"; {violated}" if violated else ""
        solve = Solve(
            status=status,
            iterations=iterations,
            primal_residual=account.primal_residual,
            dual_residual=account.dual_residual,
            why=why,
        )
        return SolverResult(commands, solve)

    def problem(self) -> QP:
        """Return the problem that was built last, without the scales of its rows."""
        at = self._arrays
        return self.form.assemble(at.A.copy(), at.q.copy(), at.l.copy(), at.u.copy())

    def scaled_problem(self) -> tuple[QP, Settings]:
        """The problem that was built last as OSQP gets it, its rows scaled, and OSQP's settings for it."""
        at = self._arrays
        settings = {
            **BASE_SETTINGS,
            "alpha": 1.0,
            "eps_abs": self._tolerance,
            "check_termination": CHECK,
            "max_iter": FIRST_BATCH,
        }
        return self.form.assemble(at.As, at.q, at.ls, at.us), settings

    def point(self) -> tuple[Array, Array]:
        """Primal (n,) and dual (m,) of ``problem`` where the last solve ended."""
        return self._arrays.x.copy(), self._arrays.y.copy()

    def _nothing(self, lin: Linearisation, why: str) -> SolverResult:
        self.reset_warm_start()
        return SolverResult(lin.U.copy(), Solve(status=SolveStatus.NON_FINITE, why=why))


@jit
def prepare(
    numbers: Array, flat: Array, target: Array, places: Indices, factor: Array, shift: float, solve: Array
) -> float:
    """The problem, its first guess, and both with scaled rows, into ``solve`` (``room``).

    Returns how much larger than GRADIENT the cost's gradient is, as a step size goes with it; -1 if a number is not
    finite.
    """
    N, states = len(target) - 1, limited_state_count(unpack_objective(numbers))
    at = unpack_arrays(solve, N, states)
    fill(numbers, flat, target, places, factor, at.A, at.q, at.l, at.u)
    first_guess(numbers, flat, target, at.q, shift, at.x, at.y)
    if rescale(places, solve, N, states) < 0:
        return -1.0
    return dual_scale(at.q, N)


@jit
def dual_scale(q: Array, N: int) -> float:
    """How much larger than for a small gradient duals, and with them step sizes and residuals, are. What an excess of a
    limited state costs is no gradient: it is paid by nobody who keeps within the limit.
    """
    gradient = 0.0
    for i in range(N * STAGE_VARIABLES + 2):
        gradient = max(gradient, abs(q[i]))
    return float(max(1.0, np.sqrt(gradient / GRADIENT)))


@jit
def first_guess(numbers: Array, flat: Array, target: Array, q: Array, shift: float, x: Array, y: Array) -> None:
    """x (n,) and y (m,) to begin with, in place of those of the last solve, ``shift`` stages earlier (NaN: of none)."""
    N = len(target) - 1
    c, lin = unpack_objective(numbers), views(flat, N)
    E = N * STATES + 2
    _shift_limits(y, E, c.t, shift)
    velocity, V = velocity_over_ground(lin.X[N], lin.C[N])
    dU, kept = np.zeros((N + 1, 2)), y[E:].copy()
    if not kept[4 * N :].any():  # no limit of the motion, of which the sweeps know nothing, was active
        _guess_commands(c, lin, target, dU, y[E:])
    if not _forward_states(c, lin, dU, x):  # but one is
        dU[:, :] = 0.0
        y[E:] = kept
        _forward_states(c, lin, dU, x)
    _guess_excesses(c, lin, q, np.isnan(shift), x, y)
    # m (p'_N - ref'_N) = y: the terminal velocity's own column
    costate = np.zeros(STATES)
    for i in range(2):
        w = velocity[i] - target[N, i]
        for j in range(3):
            w += V[i, j] * x[(N - 1) * STAGE_VARIABLES + 2 + j] * c.state_scale[2 + j]
        x[N * STAGE_VARIABLES + i] = w
        y[N * STATES + i] = c.terminal_velocity * w
        for j in range(3):
            costate[2 + j] += V[i, j] * c.terminal_velocity * w
    # lambda_(k-1) = gradient_k + A_k' lambda_k: the columns of the states
    before = np.zeros(STATES)
    for k in range(N - 1, -1, -1):
        weight = c.position * stage_length(c, k + 1) + (c.terminal_position if k == N - 1 else 0.0)
        for i in range(2):
            scale = c.state_scale[i]
            costate[i] += q[k * STAGE_VARIABLES + i] / scale + weight * x[k * STAGE_VARIABLES + i] * scale
        row = E + 4 * N + 3 * k * limited_state_count(c)
        for j in range(2):
            if np.isfinite(c.max_state[j]):
                costate[LIMITED_STATES[j]] += (y[row] + y[row + 1]) / c.state_scale[LIMITED_STATES[j]]
                row += 3
        for i in range(STATES):
            y[k * STATES + i] = costate[i] * state_scale(i, c)
        multiply_A_transposed(lin.A, k, costate, before)
        copy_to(costate, before)


@jit
def _forward_states(c: Objective, lin: Linearisation, dU: Array, x: Array) -> bool:
    """x (n,): the commands dU (N+1, 2), and the states that they lead to, by a forward sweep that closes the gaps.
    Returns whether these states are within the limits of the motion.
    """
    N, within = dU.shape[0] - 1, True
    x[:] = 0.0
    # d_(k+1) = A d_k + B0 dU_k + B1 dU_(k+1) + Phi_k - Xbar_(k+1)
    d, last = np.zeros(STATES), np.zeros(STATES)
    for k in range(N):
        multiply_A(lin.A, k, last, d)
        for i in range(STATES):
            for j in range(2):
                d[i] += lin.B0[k, i, j] * dU[k, j] + lin.B1[k, i, j] * dU[k + 1, j]
            d[i] += lin.Phi[k, i] - lin.X[k + 1, i]
            x[k * STAGE_VARIABLES + i] = d[i] / state_scale(i, c)
        copy_to(last, d)
        for i in range(2):
            x[k * STAGE_VARIABLES + STATES + i] = dU[k + 1, i] / c.scale[i]
            state = LIMITED_STATES[i]
            within &= abs(lin.X[k + 1, state] + d[state]) <= c.max_state[i]
    return within


@jit
def _guess_commands(c: Objective, lin: Linearisation, target: Array, dU: Array, y: Array) -> None:
    """Commands dU (N+1, 2), and the duals y of slew and box in place of those of the last solve:
    ``riccati_solver.py``.
    """
    N = dU.shape[0] - 1
    rows = np.empty((N, LIMIT_ROWS))
    for k in range(N):
        for i in range(2):
            rows[k, i], rows[k, 2 + i] = _known(y[2 * (N + k) + i]), _known(y[2 * k + i])
    outcome, _, _ = riccati_solver.solve(lin, target, c, riccati_solver.MAX_SWEEPS, rows, dU)
    if outcome == riccati_solver.FAILED:  # a cost that does not say what the commands should be: y as it is
        return
    for k in range(N):
        for i in range(2):
            y[2 * (N + k) + i], y[2 * k + i] = rows[k, i], rows[k, 2 + i]


@jit
def _known(dual: float) -> float:
    return dual if abs(dual) > NOT_ACTIVE else 0.0


@jit
def _guess_excesses(c: Objective, lin: Linearisation, q: Array, new: bool, x: Array, y: Array) -> None:
    """Excesses of the limited states of x, and their duals, 0 = q - y_upper + y_lower + y_excess, from those of the
    limits. A ``new`` problem has none of these yet: what is beyond its limit is held to stay there.
    """
    N = len(c.t) - 1
    column, row = N * STAGE_VARIABLES + 2, N * (STATES + 4) + 2
    for k in range(N):
        for j in range(2):
            if np.isfinite(c.max_state[j]):
                i = LIMITED_STATES[j]
                state = lin.X[k + 1, i] / c.state_scale[i] + x[k * STAGE_VARIABLES + i]
                x[column] = max(abs(state) - c.max_state[j] / c.state_scale[i], 0.0)
                if new and x[column] > 0.0:
                    y[row] = q[column] if state > 0.0 else 0.0
                    y[row + 1] = y[row] - q[column]
                y[row + 2] = min(y[row] - y[row + 1] - q[column], 0.0)
                column, row = column + 1, row + 3


@jit
def _shift_limits(y: Array, E: int, t: Array, stages: float) -> None:
    """The duals of all limits on knots t (N+1,) so many first stages later: linear between knots, the last kept."""
    if np.isnan(stages):
        y[E:] = 0.0
        return
    if stages != 0.0:
        N = len(t) - 1
        shooting_grid.shift(y[E : E + 2 * N].reshape(N, 2), t, stages)
        shooting_grid.shift(y[E + 2 * N : E + 4 * N].reshape(N, 2), t, stages)
        of_motion = y[E + 4 * N :]
        if len(of_motion) > 0:
            shooting_grid.shift(of_motion.reshape(N, len(of_motion) // N), t, stages)


@jit
def rescale(places: Indices, solve: Array, N: int, limited: int) -> int:
    """The problem and its dual with rows scaled by what the dual says of them, in ``solve`` (``room``).

    Returns 1 if a scale has changed, 0 if none has, -1 if a number is not finite.
    """
    at = unpack_arrays(solve, N, limited)
    row_of = unpack_map(places, len(at.A)).row_of
    E = N * STATES + 2
    size = dual_scale(at.q, N)
    free = min(LIMIT_ROW * size, MAX_LIMIT_ROW)
    changed, total = 0, size
    for i in range(len(at.rows)):
        active = abs(at.y[i]) > NOT_ACTIVE
        if i < E:
            s = EQUALITY_ROW
        elif i < E + 4 * N:
            s = free * ACTIVE if active else free
        elif not active:
            s = MOTION_ROW * size
        else:
            s = (EXCESS_ROW if (i - E - 4 * N) % 3 == 2 else MOTION_ACTIVE) * size
        if s != at.rows[i]:
            changed, at.rows[i] = 1, s
        at.ls[i], at.us[i], at.ys[i] = at.l[i] * s, at.u[i] * s, at.y[i] / s
        total += at.l[i] + at.u[i] + at.y[i]
    for i in range(len(at.A)):
        at.As[i] = at.A[i] * at.rows[row_of[i]]
        total += at.As[i]
    return changed if np.isfinite(total) else -1


@jit
def store_solution(numbers: Array, x: Array, y: Array, flat: Array, solve: Array, commands: Array) -> bool:
    """A solution x (n,), y (m,) of the problem with scaled rows into ``solve`` (``room``), and as commands (N+1, 2).

    Returns whether it is finite.
    """
    N = commands.shape[0] - 1
    o = unpack_objective(numbers)
    at, U, F = unpack_arrays(solve, N, limited_state_count(o)), views(flat, N).U, o.scale
    total = 0.0
    for i in range(len(x)):
        at.x[i] = x[i]
        total += x[i]
    for i in range(len(y)):
        at.y[i] = y[i] * at.rows[i]
        total += y[i]
    for i in range(2):
        commands[0, i] = U[0, i]
        for k in range(N):
            commands[k + 1, i] = U[k + 1, i] + x[k * STAGE_VARIABLES + STATES + i] * F[i]
    return bool(np.isfinite(total))
