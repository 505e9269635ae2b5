"""OSQP on the sparse QP: one workspace, updated in place, with a step size for each kind of row.

OSQP's method (Stellato et al. 2020) is the alternating direction method of multipliers with one step size rho. No
single step size suits all kinds of row: the dynamics need 1e4 to 1e7 times that of box and slew, and an active limit
100 times that of an inactive one. A row multiplied by s acts as if its step size were rho s^2, so the rows are scaled
and rho stays 1. The duals of the previous solve show beforehand which limits are active. They are checked again after
each batch of iterations: if the active set has changed, the rows are scaled again. A changes in every cycle anyway, so
this needs no additional factorisation.

First guess: commands and duals of all limits from the Riccati method (riccati_solver.py), which nearly always are
those of the solution. A forward sweep gives the states that they lead to, with the gaps closed; a backward sweep gives
the duals of the dynamics (costates). OSQP then confirms the solution after one iteration. Where the Riccati method does
not apply (a cost without a weight on thrust), the guess is the nominal trajectory with the duals of the previous solve.

Over-relaxation is off: with step sizes this unequal the plain iteration is faster.
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
    advance_deviation,
    describe_non_finite,
    multiply_A_transposed,
    unpack_linearisation,
    velocity_over_ground,
)
from ltv_mpc.control.problem_data import (
    Objective,
    is_limited,
    limited_state_count,
    stage_length,
    state_scale,
    unpack_objective,
)
from ltv_mpc.control.qp.failed_qp import worst_violation
from ltv_mpc.control.qp.problem import QP
from ltv_mpc.control.qp.riccati import HARD_ROWS, sweep_workspace
from ltv_mpc.control.qp.sparse import STAGE_VARIABLES, EntryMap, Indices, QpNumbers, SparseQp, fill
from ltv_mpc.control.solvers import riccati_solver
from ltv_mpc.control.solvers.interface import SolverResult
from ltv_mpc.control.solvers.osqp_workspace import BASE_SETTINGS, Settings, Workspace, make_workspace
from ltv_mpc.jit import copy_to, jit, jit_outlined
from ltv_mpc.messages import Array, Solve, SolveStatus
from ltv_mpc.vehicle.flow import STATES

EQUALITY_ROW = 300.0
"""Scale s of the dynamics; their step size is its square."""

LIMIT_ROW = 0.015
"""Scale s of inactive box and slew rows, if the gradient is small."""

GRADIENT = 0.5
"""Largest entry of q for which LIMIT_ROW holds. Duals grow with a larger q, and the step size with them."""

MAX_LIMIT_ROW = 0.2
"""Largest scale s of inactive box and slew rows."""

ROUNDING = 4e-9
"""Residual that rounding leaves, over the largest dual of the dynamics: with a fence no tolerance is below it. The dual
is 1e5 where two zones leave no room between them, and a row of the dynamics then is exact to 1e-6.
"""

ACTIVE = 10.0
"""Factor on the scale of active box and slew rows."""

MOTION_ROW, MOTION_ACTIVE, EXCESS_ROW = 0.05, 1.5, 15.0
"""Scales s of the limits of a state, inactive and active, and of its excess, if the gradient is small."""

PLANE_ACTIVE, PLANE_EXCESS_ROW = 0.1, 5.0
"""The same of an active half-plane of the fence and of its excess: its duals are larger, as its penalty is."""

NOT_EXCEEDED = 1e-3
"""Distance of a half-plane's dual from its penalty above which the half-plane is not exceeded."""

NOT_ACTIVE = 1e-9
"""Magnitude below which a dual is zero up to rounding."""

FIRST_BATCH = 1
"""Iterations of the first batch: the first guess usually is the solution."""

BATCH = 9
"""Iterations between two checks of the active limits."""

CONSTANT_BATCHES = 6
"""Number of batches after which each is twice as long as the one before: with constant scales OSQP always converges."""

CHECK = 3
"""Iterations between two checks of the residuals."""


class SolveArrays(NamedTuple):
    """Numbers of one solve: the problem, the point, and both with scaled rows."""

    problem: QpNumbers
    x: Array  # (n,) primal point: of the last solve, or the first guess of the next
    y: Array  # (m,) its dual
    row_scale: Array  # (m,) factor of each row
    scaled: QpNumbers  # the problem with scaled rows; q is that of ``problem``
    scaled_y: Array  # (m,) dual of the scaled rows


class OsqpSolver:
    """OSQP as the default solver of the controller."""

    def __init__(self, config: ResolvedConfig, limits: HorizonLimits) -> None:
        """Lay out the QP; OSQP is set up with the first problem.

        Parameters
        ----------
        config : knots, weights, limit of iterations; ``tolerance`` is absolute, on residuals of the scaled problem.
        limits : limits of thrusters and motion.
        """
        self._max_iterations = config.max_iterations
        self._tolerance = self._eps = config.tolerance
        self.form = SparseQp(config.knots, limits, config.weights)
        self._allocate()
        self._scale = self.form.limits.thrust_scale  # a property, and it costs time
        self._finite, self._why = False, "build() must be called before solve()"
        self._lin: Linearisation | None = None

    def _allocate(self) -> None:
        """Allocate the arrays for the present layout of the QP, and discard workspace and warm start."""
        form = self.form
        problem = form.allocate()
        self._arrays = SolveArrays(
            problem,
            np.zeros(form.variables),
            np.zeros(form.rows),
            np.zeros(form.rows),
            form.allocate()._replace(q=problem.q),
            np.zeros(form.rows),
        )
        self._shift = math.nan
        self._workspace: Workspace | None = None

    def shift_warm_start(self, stages: float) -> None:
        """Shift the duals of the limits to later knots (see ``Solver``).

        Parameters
        ----------
        stages : by how many first stages the next problem's knots lie later than the last one's.
        """
        self._shift = stages

    def reset_warm_start(self) -> None:
        """Discard the warm start (see ``Solver``)."""
        self._shift = math.nan

    def build(self, lin: Linearisation, target: Array) -> None:
        """Compute the problem, its first guess and the scales of its rows (see ``Solver``).

        Parameters
        ----------
        lin : the motion along the nominal trajectory.
        target : (N+1, 3) as in ``Solver.build``.
        """
        if self.form.match(lin):
            self._allocate()
        self._lin, form = lin, self.form
        size, costate = prepare(form.packed, lin.flat, target, form.entries, self._shift, self._arrays)
        self._finite = size >= 0.0
        self._why = "" if self._finite else describe_non_finite(lin, target)
        self._eps = max(self._tolerance * size, ROUNDING * costate if form.half_planes else 0.0)

    def update(self) -> None:
        """Pass the problem to OSQP; the first one sets it up (see ``Solver``)."""
        if not self._finite:  # a NaN would stay in the workspace for every later solve
            return
        if self._workspace is None:
            # This call changes nothing, but compiles ``rescale``, which is called next with the first hard problem.
            rescale(self.form.entries.row, self.form.stages, self._arrays)
            qp, settings = self.scaled_problem()
            self._workspace = make_workspace(qp.P, qp.q, qp.A, qp.l, qp.u, settings)
        self._workspace.load(self._arrays.scaled, self._arrays.x, self._arrays.scaled_y)

    def solve(self) -> SolverResult:
        """Solve the problem (see ``Solver``). It ends after ``max_iterations`` or a few more, never by time."""
        lin, solver = self._lin, self._workspace
        assert lin is not None  # built
        if not self._finite or solver is None:
            return self._no_solution(lin, self._why)
        at, commands = self._arrays, np.empty_like(lin.U)
        iterations, batch = 0, 0
        while True:
            length = BATCH * 2 ** max(0, batch - CONSTANT_BATCHES) if batch else FIRST_BATCH
            report = solver.solve(min(length, self._max_iterations), self._eps)
            batch += 1
            iterations += report.iterations
            if not store_solution(solver.x, solver.y, at.row_scale, lin.U, self._scale, at.x, at.y, commands):
                self._workspace = None
                return self._no_solution(lin, "OSQP returned a value that is not finite; rebuilt")
            if report.status is SolveStatus.SOLVED or iterations >= self._max_iterations:
                break
            if rescale(self.form.entries.row, self.form.stages, self._arrays) > 0:
                solver.load(at.scaled, at.x, at.scaled_y)
        self._shift = 0.0
        why = ""
        if report.status is not SolveStatus.SOLVED:
            residuals = f"primal residual {report.primal_residual:.1e}, dual {report.dual_residual:.1e}"
            why = f"OSQP: {report.status.value.replace('_', ' ')} after {iterations} iterations, {residuals}"
            violated = worst_violation(self.problem(), self._arrays.x, self.form.row_names)
            why += f"; {violated}" if violated else ""
        solve = Solve(
            status=report.status,
            iterations=iterations,
            primal_residual=report.primal_residual,
            dual_residual=report.dual_residual,
            why=why,
        )
        return SolverResult(commands, solve)

    def problem(self) -> QP:
        """Return the problem that was built last, with rows that are not scaled."""
        return self.form.assemble(QpNumbers(*(part.copy() for part in self._arrays.problem)))

    def scaled_problem(self) -> tuple[QP, Settings]:
        """Return the problem that was built last with the scaled rows that OSQP receives, and OSQP's settings."""
        settings = {
            **BASE_SETTINGS,
            "alpha": 1.0,
            "eps_abs": self._tolerance,
            "check_termination": CHECK,
            "max_iter": FIRST_BATCH,
        }
        return self.form.assemble(self._arrays.scaled), settings

    def point(self) -> tuple[Array, Array]:
        """Return the primal (n,) and dual (m,) of ``problem`` at the end of the last solve."""
        return self._arrays.x.copy(), self._arrays.y.copy()

    def _no_solution(self, lin: Linearisation, why: str) -> SolverResult:
        """Return the nominal commands and a report that says why; the warm start is discarded."""
        self.reset_warm_start()
        return SolverResult(lin.U.copy(), Solve(status=SolveStatus.NON_FINITE, why=why))


@jit
def prepare(
    packed: Array, flat: Array, target: Array, entries: EntryMap, shift: float, at: SolveArrays
) -> tuple[float, float]:
    """Compute a cycle's problem and first guess, unscaled and with scaled rows, into ``at``.

    Parameters
    ----------
    packed : a packed objective (problem_data.py).
    flat : ``Linearisation.flat``.
    target : (N+1, 3) as in ``Solver.build``.
    entries : ``SparseQp.entries``.
    shift : by how many first stages the last solve's knots were earlier; NaN if there is none to begin with.
    at : holds the point of the last solve, and is overwritten.

    Returns
    -------
    ``dual_scale`` of the problem, or -1 if a number is not finite; magnitude of the largest dual of the dynamics.
    """
    N = len(target) - 1
    lin = unpack_linearisation(flat, N)
    fill(packed, lin, target, entries, at.problem)
    first_guess(packed, lin, target, shift, at)
    if rescale(entries.row, N, at) < 0:
        return -1.0, 0.0
    costate = 0.0
    for i in range(N * STATES):
        costate = max(costate, abs(at.y[i]))
    return dual_scale(at.problem.q, N), costate


@jit
def dual_scale(q: Array, N: int) -> float:
    """Return the factor by which duals, and so step sizes and residuals, are larger than for a small gradient.

    The cost of an excess does not count as gradient: it acts only beyond a limit.

    Parameters
    ----------
    q : (n,) linear cost.
    N : stages.

    Returns
    -------
    Factor >= 1.
    """
    gradient = 0.0
    for i in range(N * STAGE_VARIABLES + 2):
        gradient = max(gradient, abs(q[i]))
    return float(max(1.0, np.sqrt(gradient / GRADIENT)))


@jit
def first_guess(packed: Array, lin: Linearisation, target: Array, shift: float, at: SolveArrays) -> None:
    """Compute the first guess of the primal and the dual.

    Parameters
    ----------
    packed : a packed objective (problem_data.py).
    lin : the motion along the nominal trajectory.
    target : (N+1, 3) as in ``Solver.build``.
    shift : by how many first stages the last solve's knots were earlier; NaN if there is none to begin with.
    at : has the problem and the point of the last solve; x and y are overwritten.
    """
    N = len(target) - 1
    objective = unpack_objective(packed)
    q, x, y = at.problem.q, at.x, at.y
    E = N * STATES + 2
    _shift_limits(y, E, limited_state_count(objective), objective.t, shift)
    velocity, V = velocity_over_ground(lin.X[N], lin.C[N])
    dU = np.zeros((N + 1, 2))
    _guess_commands(objective, lin, target, dU, y[E:])
    _forward_states(objective, lin, dU, x)
    _guess_excesses(objective, lin, q, x, y)
    # m (p'_N - ref'_N) = y: the terminal velocity's own column
    costate = np.zeros(STATES)
    for i in range(2):
        w = velocity[i] - target[N, i]
        for j in range(3):
            w += V[i, j] * x[(N - 1) * STAGE_VARIABLES + 2 + j] * objective.state_scale[2 + j]
        x[N * STAGE_VARIABLES + i] = w
        y[N * STATES + i] = objective.terminal_velocity * w
        for j in range(3):
            costate[2 + j] += V[i, j] * objective.terminal_velocity * w
    # lambda_(k-1) = gradient_k + A_k' lambda_k: the columns of the states
    before = np.zeros(STATES)
    for k in range(N - 1, -1, -1):
        weight = objective.position * stage_length(objective, k + 1) + (
            objective.terminal_position if k == N - 1 else 0.0
        )
        for i in range(2):
            scale = objective.state_scale[i]
            costate[i] += q[k * STAGE_VARIABLES + i] / scale + weight * x[k * STAGE_VARIABLES + i] * scale
        heading = objective.heading * stage_length(objective, k + 1) * x[k * STAGE_VARIABLES + 4]
        costate[4] += q[k * STAGE_VARIABLES + 4] / objective.state_scale[4] + heading * objective.state_scale[4]
        row = E + 4 * N + 3 * k * limited_state_count(objective)
        for j in range(2):
            if is_limited(objective, j):
                costate[LIMITED_STATES[j]] += (y[row] + y[row + 1]) / objective.state_scale[LIMITED_STATES[j]]
                row += 3
        row = E + N * (4 + 3 * limited_state_count(objective)) + 2 * k * lin.rows.shape[1]
        for j in range(lin.rows.shape[1]):
            for i in range(2):
                costate[i] += lin.rows[k, j, i] * y[row + 2 * j]
        for i in range(STATES):
            y[k * STATES + i] = costate[i] * state_scale(i, objective)
        multiply_A_transposed(lin.A, k, costate, before)
        copy_to(costate, before)


@jit_outlined
def _forward_states(objective: Objective, lin: Linearisation, dU: Array, x: Array) -> None:
    """Compute x (n,) from the commands' deviations dU (N+1, 2) by a forward sweep that closes the gaps."""
    N = dU.shape[0] - 1
    x[:] = 0.0
    d, last = np.zeros(STATES), np.zeros(STATES)
    for k in range(N):
        advance_deviation(lin, k, dU, last, d)
        for i in range(STATES):
            x[k * STAGE_VARIABLES + i] = d[i] / state_scale(i, objective)
        for i in range(2):
            x[k * STAGE_VARIABLES + STATES + i] = dU[k + 1, i] / objective.thrust_scale[i]


@jit
def _guess_commands(objective: Objective, lin: Linearisation, target: Array, dU: Array, y: Array) -> None:
    """Compute the commands' deviations dU (N+1, 2) and the duals y of all limits by the Riccati method.

    Its active set starts from the duals of the last solve.
    """
    N, L, P = dU.shape[0] - 1, limited_state_count(objective), lin.rows.shape[1]
    rows = np.empty((N, HARD_ROWS + L + P))
    planes = (4 + 3 * L) * N
    for k in range(N):
        for i in range(2):
            rows[k, i], rows[k, 2 + i] = _known(y[2 * (N + k) + i]), _known(y[2 * k + i])
        for m in range(L):
            upper = 4 * N + 3 * (k * L + m)
            rows[k, HARD_ROWS + m] = _known(y[upper]) + _known(y[upper + 1])
        for m in range(P):
            rows[k, HARD_ROWS + L + m] = _known(y[planes + 2 * (k * P + m)])
    work = sweep_workspace(lin, target, objective)
    outcome, _, _ = riccati_solver.solve(lin, target, objective, work, riccati_solver.MAX_SWEEPS, rows, dU)
    if outcome == riccati_solver.FAILED:  # the cost does not determine the commands: y stays
        return
    for k in range(N):
        for i in range(2):
            y[2 * (N + k) + i], y[2 * k + i] = rows[k, i], rows[k, 2 + i]
        for m in range(L):
            upper, dual = 4 * N + 3 * (k * L + m), rows[k, HARD_ROWS + m]
            y[upper], y[upper + 1] = max(dual, 0.0), min(dual, 0.0)
        for m in range(P):
            y[planes + 2 * (k * P + m)] = rows[k, HARD_ROWS + L + m]


@jit
def _known(dual: float) -> float:
    """Return the dual, or exactly zero if it is zero up to rounding."""
    return dual if abs(dual) > NOT_ACTIVE else 0.0


@jit
def _guess_excesses(objective: Objective, lin: Linearisation, q: Array, x: Array, y: Array) -> None:
    """Compute the excesses of the limited states, and their duals from those of the limits.

    0 = q - y_upper + y_lower + y_excess.
    """
    N = len(objective.t) - 1
    column, row = N * STAGE_VARIABLES + 2, N * (STATES + 4) + 2
    for k in range(N):
        for j in range(2):
            if is_limited(objective, j):
                i = LIMITED_STATES[j]
                scale = objective.state_scale[i]
                state = lin.X[k + 1, i] / scale + x[k * STAGE_VARIABLES + i]
                above = state - objective.high_state[j] / scale
                x[column] = max(above, objective.low_state[j] / scale - state, 0.0)
                y[row + 2] = min(y[row] - y[row + 1] - q[column], 0.0)
                column, row = column + 1, row + 3
    for k in range(N):
        for j in range(lin.rows.shape[1]):
            a = lin.rows[k, j]
            value = 0.0
            for i in range(2):
                value += a[i] * objective.state_scale[i] * x[k * STAGE_VARIABLES + i]
            y[row + 1] = min(-y[row] - q[column], 0.0)
            x[column] = max(a[2] - value, 0.0) if y[row + 1] > -NOT_EXCEEDED else 0.0
            column, row = column + 1, row + 2


@jit
def _shift_limits(y: Array, E: int, L: int, t: Array, stages: float) -> None:
    """Shift the duals of all limits to later knots: linear between the knots t (N+1,), constant after the last."""
    if np.isnan(stages):
        y[E:] = 0.0
        return
    if stages != 0.0:
        N = len(t) - 1
        shooting_grid.shift(y[E : E + 2 * N].reshape(N, 2), t, stages)
        shooting_grid.shift(y[E + 2 * N : E + 4 * N].reshape(N, 2), t, stages)
        of_motion, of_fence = y[E + 4 * N : E + (4 + 3 * L) * N], y[E + (4 + 3 * L) * N :]
        if len(of_motion) > 0:
            shooting_grid.shift(of_motion.reshape(N, 3 * L), t, stages)
        if len(of_fence) > 0:
            shooting_grid.shift(of_fence.reshape(N, len(of_fence) // N), t, stages)


@jit
def rescale(row: Indices, N: int, at: SolveArrays) -> int:
    """Scale the rows of the problem and of its dual, by the limits that the dual shows to be active.

    Parameters
    ----------
    row : (nnz,) row of each stored entry of A (``EntryMap``).
    N : stages.
    at : its scaled parts are overwritten.

    Returns
    -------
    1 if a scale has changed, 0 if none has, -1 if a number is not finite.
    """
    problem, scaled, y = at.problem, at.scaled, at.y
    E = N * STATES + 2
    size = dual_scale(problem.q, N)
    free = min(LIMIT_ROW * size, MAX_LIMIT_ROW)
    # A stage has 1 column and 3 rows for each limited state, 1 column and 2 rows for each half-plane.
    planes = len(y) - 2 * (len(at.x) - N * STAGE_VARIABLES - 2) - E - 4 * N  # 3 a + 2 b - 2 (a + b)
    planes = E + 4 * N + 3 * planes
    changed, total = 0, size
    for i in range(len(at.row_scale)):
        active = abs(y[i]) > NOT_ACTIVE
        if i < E:
            s = EQUALITY_ROW
        elif i < E + 4 * N:
            s = free * ACTIVE if active else free
        elif not active:
            s = MOTION_ROW * size
        elif i < planes:
            s = (EXCESS_ROW if (i - E - 4 * N) % 3 == 2 else MOTION_ACTIVE) * size
        else:
            s = (PLANE_EXCESS_ROW if (i - planes) % 2 == 1 else PLANE_ACTIVE) * size
        if s != at.row_scale[i]:
            changed, at.row_scale[i] = 1, s
        scaled.l[i], scaled.u[i], at.scaled_y[i] = problem.l[i] * s, problem.u[i] * s, y[i] / s
        total += problem.l[i] + problem.u[i] + y[i]
    for i in range(len(problem.A)):
        scaled.A[i] = problem.A[i] * at.row_scale[row[i]]
        total += scaled.A[i]
    return changed if np.isfinite(total) else -1


@jit
def store_solution(
    solution: Array, scaled_y: Array, row_scale: Array, U: Array, F: Array, x: Array, y: Array, commands: Array
) -> bool:
    """Store a solution, with the dual of the unscaled rows, and compute its commands.

    Parameters
    ----------
    solution : (n,) primal solution.
    scaled_y : (m,) its dual, of the scaled rows.
    row_scale : (m,) factor of each row.
    U : (N+1, 2) nominal commands (N).
    F : (2,) scale of the thrusts (N).
    x : (n,) is overwritten with the primal solution.
    y : (m,) is overwritten with the dual of the unscaled rows.
    commands : (N+1, 2) is overwritten with the commands (N).

    Returns
    -------
    True if the solution is finite.
    """
    total = 0.0
    for i in range(len(x)):
        x[i] = solution[i]
        total += x[i]
    for i in range(len(y)):
        y[i] = scaled_y[i] * row_scale[i]
        total += scaled_y[i]
    for i in range(2):
        commands[0, i] = U[0, i]
        for k in range(commands.shape[0] - 1):
            commands[k + 1, i] = U[k + 1, i] + x[k * STAGE_VARIABLES + STATES + i] * F[i]
    return bool(np.isfinite(total))
