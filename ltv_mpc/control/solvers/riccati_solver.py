"""The QP solved along its stages: which limits are active is found, the rest is Riccati's (``qp/riccati.py``).

Two ways, the second where the first does not settle:

    active set       Limits whose dual y was not zero in the last solve are held by a weight that leaves nothing of
                     them: w = RHO, l = y - RHO b for each such row g = b. Then y + RHO (g - b) is its dual; a row whose
                     dual has the wrong sign is let go, one that is violated is held, and again (a primal-dual active
                     set method: Hintermueller, Ito & Kunisch 2002; with the multipliers of Hestenes 1969). Where the
                     last cycle's set still holds, this is one sweep.
    interior point   Every row has slacks t > 0 and duals nu > 0 on both sides, w = nu / t, l = sigma mu / t + nu - w b,
                     and steps that keep them positive while their products go to zero (Rao, Wright & Rawlings 1998).
                     It takes five to fifteen sweeps whatever the start; as soon as it says twice which rows are active
                     the first way ends it, exactly.

What it comes to is exact to 1e-5 of a thruster's largest thrust. By itself it is the solver ``riccati``; OSQP takes
what it says as a first guess, and is done as soon as it has looked at its residuals.
"""

from __future__ import annotations

import math

import numpy as np

from ltv_mpc.control import shooting_grid
from ltv_mpc.control.config import ResolvedConfig
from ltv_mpc.control.horizon_limits import HorizonLimits
from ltv_mpc.control.linearisation import Linearisation, describe_non_finite, views
from ltv_mpc.control.problem_data import Objective, pack_objective, unpack_objective
from ltv_mpc.control.qp.riccati import LIMIT_ROWS, SweepWorkspace, sweep, sweep_workspace
from ltv_mpc.control.solvers.interface import SolverResult
from ltv_mpc.jit import jit
from ltv_mpc.messages import Array, Solve, SolveStatus

RHO = 1e6
"""Against a curvature of about 1: a row that is held is off by the change of its dual / RHO."""

VIOLATION_TOLERANCE, DUAL_SIGN_TOLERANCE = 1e-7, 1e-7
"""By how much a row must be violated, or a dual be of the wrong sign, to count: of the largest thrust; of the cost that
it may have. Rounding, times RHO, is a hundred times less.
"""

HELD_ROW_TOLERANCE = 1e-5
"""By how much a row that is held may be off, of the largest thrust."""

FIRST_SWEEPS, LATER_SWEEPS = 2, 2
"""Sweeps that the active set may take: with the last solve's rows, with those that the interior point names."""

SIGMA = 0.1
"""Of the mean product of slack and dual, what a step aims at."""

INITIAL_SLACK, INITIAL_DUAL = 0.3, 0.3
"""Where the interior point begins."""

MU_IDENTIFIED, MU_CONVERGED = 1e-3, 1e-10
"""Mean product below which its slacks and duals say which rows are active; below which it is the solution itself, to
rounding: where a limit is just reached, and its dual is zero, no set is the right one.
"""

TO_BOUNDARY = 0.995
"""Of the way to where a slack or a dual would be zero."""

MAX_SWEEPS = 60
"""Twice what the hardest problems seen took."""

FAILED, NOT_CONVERGED, CONVERGED = -1, 0, 1
"""What came of it: nothing of use; nearly a solution; the solution."""


class RiccatiSolver:
    """The method by itself: nothing is laid out, factorised or copied but what the sweeps want."""

    def __init__(self, config: ResolvedConfig, limits: HorizonLimits) -> None:
        """``config`` says how many stages, and the weights; ``limits`` has none of the motion."""
        self._most = config.max_iterations
        self._numbers = pack_objective(config.knots, limits, config.weights)
        self._duals = np.zeros((config.stages, LIMIT_ROWS))
        self._shift = math.nan
        self._lin: Linearisation | None = None
        self._target = np.zeros((config.stages + 1, 2))

    def shift_warm_start(self, stages: float) -> None:
        """Duals of box and slew move with the plan, the last ones stay."""
        self._shift = stages

    def reset_warm_start(self) -> None:
        """The next solve begins with no active row."""
        self._shift = math.nan

    def build(self, lin: Linearisation, target: Array) -> None:
        """As in ``Solver``: there is nothing to build."""
        self._lin, self._target = lin, target

    def update(self) -> None:
        """As in ``Solver``: nor to hand over."""

    def solve(self) -> SolverResult:
        """As in ``Solver``."""
        lin = self._lin
        assert lin is not None, "build() must be called before solve()"
        commands = np.empty_like(lin.U)
        outcome, sweeps, beyond = solve_packed(
            self._numbers, lin.flat, self._target, self._shift, self._most, self._duals, commands
        )
        if outcome == FAILED:
            self.reset_warm_start()
            finite = np.isfinite(lin.flat).all() and np.isfinite(self._target).all()
            why = (
                "the cost is singular: it does not determine the commands"
                if finite
                else describe_non_finite(lin, self._target)
            )
            status = SolveStatus.FAILED if finite else SolveStatus.NON_FINITE
            return SolverResult(lin.U.copy(), Solve(status=status, iterations=sweeps, why=why))
        self._shift = 0.0
        solved = outcome == CONVERGED
        why = "" if solved else f"active set not found within {sweeps} Riccati sweeps"
        status = SolveStatus.SOLVED if solved else SolveStatus.ITERATION_LIMIT
        return SolverResult(commands, Solve(status=status, iterations=sweeps, primal_residual=beyond, why=why))


@jit
def solve_packed(
    numbers: Array, flat: Array, target: Array, stages: float, most: int, y: Array, commands: Array
) -> tuple[int, int, float]:
    """The commands (N+1, 2) of a linearisation's flat array, and the duals y (N, 4) in place of those of a problem that
    began so many first stages earlier (NaN: of none). Returns besides by how much a row is violated at most.
    """
    N = len(target) - 1
    lin, o = views(flat, N), unpack_objective(numbers)
    shift_duals(y, o.t, stages)
    outcome, sweeps, beyond = solve(lin, target, o, most, y, commands)
    for k in range(N + 1):
        for i in range(2):
            commands[k, i] += lin.U[k, i]
    return outcome, sweeps, beyond


@jit
def shift_duals(y: Array, t: Array, stages: float) -> None:
    """y (N, 4) on knots t (N+1,) so many first stages later (``grid.shift``); NaN: none."""
    if np.isnan(stages):
        y[:, :] = 0.0
    elif stages != 0.0:
        shooting_grid.shift(y, t, stages)


@jit
def solve(lin: Linearisation, target: Array, o: Objective, most: int, y: Array, dU: Array) -> tuple[int, int, float]:
    """dU (N+1, 2), deviations of the commands (N), and the duals y (N, 4) of box and slew (``sweeps``), in place of
    those of the last solve, whose signs are where it begins. Limits of the motion are not looked at. It is given up
    after ``most`` sweeps, or two more.

    Returns what came of it, how many sweeps that took, and by how much a row is violated at most.
    """
    work, active = sweep_workspace(lin, o), np.sign(y)
    outcome, sweeps = _active_set(lin, target, o, work, active, FIRST_SWEEPS, y, dU)
    if outcome == NOT_CONVERGED:
        outcome, more = _interior_point(lin, target, o, work, active, most - sweeps, y, dU)
        sweeps += more
    if outcome == FAILED:
        dU[:, :] = 0.0
        y[:, :] = 0.0
        return outcome, sweeps, 0.0
    beyond = 0.0
    for k in range(y.shape[0]):
        for i in range(LIMIT_ROWS):
            beyond = max(beyond, work.g[k, i] - work.high[k, i], work.low[k, i] - work.g[k, i])
    return outcome, sweeps, beyond


@jit
def _active_set(
    lin: Linearisation, target: Array, o: Objective, work: SweepWorkspace, active: Array, most: int, y: Array, dU: Array
) -> tuple[int, int]:
    """By the active set; ``active`` (N, 4) is the sign of each row's dual y, 0 of one that is not held."""
    N, low, high = active.shape[0], work.low, work.high
    weight, linear, g = work.weight, work.linear, work.g
    for turn in range(1, most + 1):
        for k in range(N):
            for i in range(LIMIT_ROWS):
                held = active[k, i]
                if held == 0.0:
                    weight[k, i] = linear[k, i] = 0.0
                else:
                    weight[k, i] = RHO
                    linear[k, i] = y[k, i] - RHO * (high[k, i] if held > 0.0 else low[k, i])
        if not sweep(lin, target, o, work, dU):
            return FAILED, turn
        changed = False
        for k in range(N):
            for i in range(LIMIT_ROWS):
                held, dual = active[k, i], weight[k, i] * g[k, i] + linear[k, i]
                if held != 0.0 and dual * held >= -DUAL_SIGN_TOLERANCE:
                    changed |= abs(dual - y[k, i]) > RHO * HELD_ROW_TOLERANCE
                    y[k, i] = dual
                    continue
                y[k, i] = now = 0.0
                if g[k, i] > high[k, i] + VIOLATION_TOLERANCE:
                    now = 1.0
                elif g[k, i] < low[k, i] - VIOLATION_TOLERANCE:
                    now = -1.0
                if now != held:
                    active[k, i], changed = now, True
        if not changed:
            return CONVERGED, turn
    return NOT_CONVERGED, most


@jit
def _interior_point(
    lin: Linearisation, target: Array, o: Objective, work: SweepWorkspace, active: Array, most: int, y: Array, dU: Array
) -> tuple[int, int]:
    """By the interior point, until the active set takes it from there."""
    N, low, high = active.shape[0], work.low, work.high
    weight, linear, g = work.weight, work.linear, work.g
    # slack and dual of the upper bounds, then of the lower ones, and their steps
    t, nu = np.empty((2, N, LIMIT_ROWS)), np.empty((2, N, LIMIT_ROWS))
    dt, dnu = np.empty((2, N, LIMIT_ROWS)), np.empty((2, N, LIMIT_ROWS))
    for k in range(N):
        for i in range(LIMIT_ROWS):
            t[0, k, i], t[1, k, i] = max(high[k, i], INITIAL_SLACK), max(-low[k, i], INITIAL_SLACK)
            nu[0, k, i] = nu[1, k, i] = INITIAL_DUAL
    sweeps, mu = 0, _mean_product(t, nu)
    while sweeps < most:
        aim = SIGMA * mu
        for k in range(N):
            for i in range(LIMIT_ROWS):
                above, below = nu[0, k, i] / t[0, k, i], nu[1, k, i] / t[1, k, i]
                weight[k, i] = above + below
                linear[k, i] = aim / t[0, k, i] + nu[0, k, i] - above * high[k, i]
                linear[k, i] -= aim / t[1, k, i] + nu[1, k, i] + below * low[k, i]
        sweeps += 1
        if not sweep(lin, target, o, work, dU):
            return FAILED, sweeps
        primal = dual = 1.0
        for k in range(N):
            for i in range(LIMIT_ROWS):
                for side in range(2):
                    T, V = t[side, k, i], nu[side, k, i]
                    # t + dt is what is left to the bound, and (t + dt)(nu + dnu) = aim to first order
                    left = high[k, i] - g[k, i] if side == 0 else g[k, i] - low[k, i]
                    down, fall = left - T, (aim - V * (left - T)) / T - V
                    dt[side, k, i], dnu[side, k, i] = down, fall
                    if down < 0.0:
                        primal = min(primal, -TO_BOUNDARY * T / down)
                    if fall < 0.0:
                        dual = min(dual, -TO_BOUNDARY * V / fall)
        same = True
        for k in range(N):
            for i in range(LIMIT_ROWS):
                for side in range(2):
                    t[side, k, i] += primal * dt[side, k, i]
                    nu[side, k, i] += dual * dnu[side, k, i]
                now = 0.0
                if nu[0, k, i] > t[0, k, i]:
                    now = 1.0
                elif nu[1, k, i] > t[1, k, i]:
                    now = -1.0
                if now != active[k, i]:
                    active[k, i], same = now, False
        mu = _mean_product(t, nu)
        if not np.isfinite(mu):
            return FAILED, sweeps
        if mu < MU_IDENTIFIED and (same or mu < MU_CONVERGED):
            _duals(nu, y)
            if mu < MU_CONVERGED:
                return CONVERGED, sweeps
            outcome, more = _active_set(lin, target, o, work, active, LATER_SWEEPS, y, dU)
            sweeps += more
            if outcome != NOT_CONVERGED:
                return outcome, sweeps
    _duals(nu, y)
    return NOT_CONVERGED, sweeps


@jit
def _duals(nu: Array, y: Array) -> None:
    """y (N, 4) of the duals of both sides."""
    for k in range(y.shape[0]):
        for i in range(LIMIT_ROWS):
            y[k, i] = nu[0, k, i] - nu[1, k, i]


@jit
def _mean_product(t: Array, nu: Array) -> float:
    total = 0.0
    for side in range(2):
        for k in range(t.shape[1]):
            for i in range(LIMIT_ROWS):
                total += t[side, k, i] * nu[side, k, i]
    return total / t.size
