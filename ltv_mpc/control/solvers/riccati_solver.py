"""Riccati solver: it finds the active limits, and solves the rest by Riccati sweeps (qp/riccati.py).

It has two methods, the second for problems in which the first does not converge:

    active set       Limits whose dual y was not zero in the last solve are held by a large weight: w = RHO,
                     l = y - RHO b for each such row g = b. Then y + RHO (g - b) is its dual. A row whose dual has the
                     wrong sign is released, a violated row is added, and the sweep is repeated (a primal-dual active
                     set method: Hintermueller, Ito & Kunisch 2002; with the multipliers of Hestenes 1969). If the last
                     cycle's set is still right, one sweep is enough.
    interior point   Every row has slacks t > 0 and duals nu > 0 on both sides, w = nu / t, l = sigma mu / t + nu - w b,
                     and steps that keep them positive while their products go to zero (Rao, Wright & Rawlings 1998).
                     It takes five to fifteen sweeps from any start. When it names the same active rows twice, the
                     active-set method finishes the solve, exactly.

The result is exact to 1e-5 of a thruster's largest thrust. The method is the solver ``riccati``; OSQP takes its result
as a first guess, and has only to check its residuals.

Arguments of the kernels in this file:

    lin      the motion along the nominal trajectory
    target   (N+1, 2) as in ``Solver.build``
    o        weights, limits and scales
    work     workspace of the sweeps
    active   (N, 4) sign of each row's dual, 0 if the row is not held; order of rows as in qp/riccati.py
    y        (N, 4) duals of box and slew
    dU       (N+1, 2) deviations of the commands from the nominal ones (N); overwritten
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ltv_mpc.control import shooting_grid
from ltv_mpc.control.config import ResolvedConfig
from ltv_mpc.control.horizon_limits import HorizonLimits
from ltv_mpc.control.linearisation import Linearisation, describe_non_finite, unpack_linearisation
from ltv_mpc.control.problem_data import Objective, pack_objective, unpack_objective
from ltv_mpc.control.qp.riccati import LIMIT_ROWS, SweepWorkspace, sweep, sweep_workspace
from ltv_mpc.control.solvers.interface import SolverResult
from ltv_mpc.errors import ConfigError
from ltv_mpc.jit import jit
from ltv_mpc.messages import Array, Solve, SolveStatus

RHO = 1e6
"""Weight of a row that is held, against a curvature of about 1: its error is the change of its dual / RHO."""

VIOLATION_TOLERANCE = 1e-7
"""Smallest violation that counts, over the largest thrust. Rounding, times RHO, is a hundred times smaller."""

DUAL_SIGN_TOLERANCE = 1e-7
"""Smallest dual of the wrong sign that counts, in units of the cost."""

HELD_ROW_TOLERANCE = 1e-5
"""Largest error of a row that is held, over the largest thrust."""

FIRST_SWEEPS, LATER_SWEEPS = 2, 2
"""Limits of the active-set sweeps: with the last solve's rows, and with those that the interior point names."""

SIGMA = 0.1
"""Centring parameter: a step aims at this part of the mean product of slack and dual."""

INITIAL_SLACK, INITIAL_DUAL = 0.3, 0.3
"""Smallest slack, and dual, at which the interior point starts."""

MU_IDENTIFIED, MU_CONVERGED = 1e-3, 1e-10
"""Mean product of slack and dual below which they show which rows are active, and below which the point is the solution
itself, to rounding. The second ends a solve in which a limit is just reached with a dual of zero: no set is right
there.
"""

TO_BOUNDARY = 0.995
"""Largest part of the step to where a slack or a dual would be zero."""

MAX_SWEEPS = 60
"""Limit of sweeps: twice what the hardest problems seen took."""

FAILED, NOT_CONVERGED, CONVERGED = -1, 0, 1
"""Outcome of a method: no usable result; nearly a solution; the solution."""


class RiccatiSolver:
    """Riccati method as a solver of the controller; it cannot take limits of the motion."""

    def __init__(self, config: ResolvedConfig, limits: HorizonLimits) -> None:
        """Allocate the duals, which are the warm start.

        Parameters
        ----------
        config : number of stages, knots, weights and limit of iterations.
        limits : limits of the thrusters; none of the motion.

        Raises
        ------
        ConfigError
            The motion has limits, which this method cannot take.
        """
        if limits.limited_states:
            problem = "does not support motion limits: use osqp or a solver of qpsolvers"
            raise ConfigError("controller settings", "solver", problem, value=config.solver)
        self._max_sweeps = config.max_iterations
        self._packed = pack_objective(config.knots, limits, config.weights)
        self._duals = np.zeros((config.stages, LIMIT_ROWS))
        self._shift = math.nan
        self._lin: Linearisation | None = None
        self._target = np.zeros((config.stages + 1, 2))

    def shift_warm_start(self, stages: float) -> None:
        """Move the duals of box and slew with the plan; the last ones are held."""
        self._shift = stages

    def reset_warm_start(self) -> None:
        """Start the next solve with no active row."""
        self._shift = math.nan

    def build(self, lin: Linearisation, target: Array) -> None:
        """Keep the problem: the sweeps read it as it is."""
        self._lin, self._target = lin, target

    def update(self) -> None:
        """Do nothing: there is no workspace to update."""

    def solve(self) -> SolverResult:
        """Solve the problem (see ``Solver``)."""
        lin = self._lin
        assert lin is not None, "build() must be called before solve()"
        commands = np.empty_like(lin.U)
        outcome, sweeps, violation = solve_packed(
            self._packed, lin.flat, self._target, self._shift, self._max_sweeps, self._duals, commands
        )
        if outcome == FAILED:
            self.reset_warm_start()
            finite = np.isfinite(lin.flat).all() and np.isfinite(self._target).all()
            singular = "the cost is singular: it does not determine the commands"
            why = singular if finite else describe_non_finite(lin, self._target)
            status = SolveStatus.FAILED if finite else SolveStatus.NON_FINITE
            return SolverResult(lin.U.copy(), Solve(status=status, iterations=sweeps, why=why))
        self._shift = 0.0
        solved = outcome == CONVERGED
        why = "" if solved else f"active set not found within {sweeps} Riccati sweeps"
        status = SolveStatus.SOLVED if solved else SolveStatus.ITERATION_LIMIT
        return SolverResult(commands, Solve(status=status, iterations=sweeps, primal_residual=violation, why=why))


@jit
def solve_packed(
    packed: Array, flat: Array, target: Array, stages: float, max_sweeps: int, y: Array, commands: Array
) -> tuple[int, int, float]:
    """Solve a problem whose weights and limits are packed, from the duals of an earlier one.

    Parameters
    ----------
    packed : a packed objective (problem_data.py).
    flat : ``Linearisation.flat``.
    target, max_sweeps : as in ``solve``.
    stages : by how many first stages the knots of the earlier problem lie earlier; NaN if there is none.
    y : (N, 4) duals of the earlier problem; overwritten with those of this one.
    commands : (N+1, 2) is overwritten with the commands (N).

    Returns
    -------
    Outcome, number of sweeps and largest violation, as ``solve``.
    """
    o, lin = unpack_objective(packed), unpack_linearisation(flat, len(target) - 1)
    shift_duals(y, o.t, stages)
    outcome, sweeps, violation = solve(lin, target, o, max_sweeps, y, commands)
    for k in range(len(target)):
        for i in range(2):
            commands[k, i] += lin.U[k, i]
    return outcome, sweeps, violation


@jit
def shift_duals(y: Array, t: Array, stages: float) -> None:
    """Shift duals to knots that lie later, or set them to zero.

    Parameters
    ----------
    y : (N, 4) duals; overwritten.
    t : (N+1,) knots in first stages.
    stages : by how many first stages the new knots lie later; NaN: set the duals to zero.
    """
    if np.isnan(stages):
        y[:, :] = 0.0
    elif stages != 0.0:
        shooting_grid.shift(y, t, stages)


@jit
def solve(
    lin: Linearisation, target: Array, o: Objective, max_sweeps: int, y: Array, dU: Array
) -> tuple[int, int, float]:
    """Solve the QP without its limits of the motion.

    Parameters
    ----------
    lin, target, o, dU : as at the head of this file.
    max_sweeps : limit of sweeps; the solve can take two more.
    y : (N, 4) duals of the last solve, whose signs are the first active set; overwritten with those of this one.

    Returns
    -------
    FAILED, NOT_CONVERGED or CONVERGED; number of sweeps; largest violation of a row, over the largest thrust.
    """
    work, active = sweep_workspace(lin, o), np.sign(y)
    outcome, sweeps = _active_set(lin, target, o, work, active, FIRST_SWEEPS, y, dU)
    if outcome == NOT_CONVERGED:
        outcome, more = _interior_point(lin, target, o, work, active, max_sweeps - sweeps, y, dU)
        sweeps += more
    if outcome == FAILED:
        dU[:, :] = 0.0
        y[:, :] = 0.0
        return outcome, sweeps, 0.0
    violation = 0.0
    for k in range(y.shape[0]):
        for i in range(LIMIT_ROWS):
            violation = max(violation, work.g[k, i] - work.high[k, i], work.low[k, i] - work.g[k, i])
    return outcome, sweeps, violation


@jit
def _active_set(
    lin: Linearisation,
    target: Array,
    o: Objective,
    work: SweepWorkspace,
    active: Array,
    max_sweeps: int,
    y: Array,
    dU: Array,
) -> tuple[int, int]:
    """Solve by the active-set method; return its outcome and the number of sweeps."""
    N, low, high = active.shape[0], work.low, work.high
    weight, linear, g = work.weight, work.linear, work.g
    for sweeps in range(1, max_sweeps + 1):
        for k in range(N):
            for i in range(LIMIT_ROWS):
                held = active[k, i]
                if held == 0.0:
                    weight[k, i] = linear[k, i] = 0.0
                else:
                    weight[k, i] = RHO
                    linear[k, i] = y[k, i] - RHO * (high[k, i] if held > 0.0 else low[k, i])
        if not sweep(lin, target, o, work, dU):
            return FAILED, sweeps
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
            return CONVERGED, sweeps
    return NOT_CONVERGED, max_sweeps


class _Barrier(NamedTuple):
    """Slacks and duals of the upper bounds (0) and of the lower ones (1), and their steps."""

    t: Array  # (2, N, 4)
    nu: Array
    dt: Array
    dnu: Array


@jit
def _interior_point(
    lin: Linearisation,
    target: Array,
    o: Objective,
    work: SweepWorkspace,
    active: Array,
    max_sweeps: int,
    y: Array,
    dU: Array,
) -> tuple[int, int]:
    """Solve by the interior-point method until the active set is known; return the outcome and the number of sweeps."""
    barrier = _initial_barrier(work)
    sweeps, mu = 0, _mean_product(barrier)
    while sweeps < max_sweeps:
        aim = SIGMA * mu
        _set_barrier_terms(barrier, aim, work)
        sweeps += 1
        if not sweep(lin, target, o, work, dU):
            return FAILED, sweeps
        primal, dual = _find_step(barrier, aim, work)
        same = _take_step(barrier, primal, dual, active)
        mu = _mean_product(barrier)
        if not np.isfinite(mu):
            return FAILED, sweeps
        if mu < MU_IDENTIFIED and (same or mu < MU_CONVERGED):
            _duals(barrier.nu, y)
            if mu < MU_CONVERGED:
                return CONVERGED, sweeps
            outcome, more = _active_set(lin, target, o, work, active, LATER_SWEEPS, y, dU)
            sweeps += more
            if outcome != NOT_CONVERGED:
                return outcome, sweeps
    _duals(barrier.nu, y)
    return NOT_CONVERGED, sweeps


@jit
def _initial_barrier(work: SweepWorkspace) -> _Barrier:
    """Return the slacks and duals at which the interior point starts."""
    N, low, high = work.low.shape[0], work.low, work.high
    t, nu = np.empty((2, N, LIMIT_ROWS)), np.empty((2, N, LIMIT_ROWS))
    dt, dnu = np.empty((2, N, LIMIT_ROWS)), np.empty((2, N, LIMIT_ROWS))
    for k in range(N):
        for i in range(LIMIT_ROWS):
            t[0, k, i], t[1, k, i] = max(high[k, i], INITIAL_SLACK), max(-low[k, i], INITIAL_SLACK)
            nu[0, k, i] = nu[1, k, i] = INITIAL_DUAL
    return _Barrier(t, nu, dt, dnu)


@jit
def _set_barrier_terms(barrier: _Barrier, aim: float, work: SweepWorkspace) -> None:
    """Set weight and linear of the next sweep: w = nu / t, l = aim / t + nu - w b, of both sides of each row."""
    t, nu, low, high = barrier.t, barrier.nu, work.low, work.high
    for k in range(t.shape[1]):
        for i in range(LIMIT_ROWS):
            above, below = nu[0, k, i] / t[0, k, i], nu[1, k, i] / t[1, k, i]
            work.weight[k, i] = above + below
            work.linear[k, i] = aim / t[0, k, i] + nu[0, k, i] - above * high[k, i]
            work.linear[k, i] -= aim / t[1, k, i] + nu[1, k, i] + below * low[k, i]


@jit
def _find_step(barrier: _Barrier, aim: float, work: SweepWorkspace) -> tuple[float, float]:
    """Compute the steps of slacks and duals; return the fractions of them that keep both positive."""
    low, high, g = work.low, work.high, work.g
    primal = dual = 1.0
    for k in range(g.shape[0]):
        for i in range(LIMIT_ROWS):
            for side in range(2):
                t, nu = barrier.t[side, k, i], barrier.nu[side, k, i]
                # t + dt is the distance to the bound, and (t + dt)(nu + dnu) = aim to first order
                distance = high[k, i] - g[k, i] if side == 0 else g[k, i] - low[k, i]
                dt, dnu = distance - t, (aim - nu * (distance - t)) / t - nu
                barrier.dt[side, k, i], barrier.dnu[side, k, i] = dt, dnu
                if dt < 0.0:
                    primal = min(primal, -TO_BOUNDARY * t / dt)
                if dnu < 0.0:
                    dual = min(dual, -TO_BOUNDARY * nu / dnu)
    return primal, dual


@jit
def _take_step(barrier: _Barrier, primal: float, dual: float, active: Array) -> bool:
    """Take the step, and update the active rows; return True if they are the same as before."""
    t, nu = barrier.t, barrier.nu
    same = True
    for k in range(active.shape[0]):
        for i in range(LIMIT_ROWS):
            for side in range(2):
                t[side, k, i] += primal * barrier.dt[side, k, i]
                nu[side, k, i] += dual * barrier.dnu[side, k, i]
            now = 0.0
            if nu[0, k, i] > t[0, k, i]:
                now = 1.0
            elif nu[1, k, i] > t[1, k, i]:
                now = -1.0
            if now != active[k, i]:
                active[k, i], same = now, False
    return same


@jit
def _duals(nu: Array, y: Array) -> None:
    """Compute y (N, 4) from the duals of both sides."""
    for k in range(y.shape[0]):
        for i in range(LIMIT_ROWS):
            y[k, i] = nu[0, k, i] - nu[1, k, i]


@jit
def _mean_product(barrier: _Barrier) -> float:
    """Return mu, the mean product of slack and dual."""
    t, nu = barrier.t, barrier.nu
    total = 0.0
    for side in range(2):
        for k in range(t.shape[1]):
            for i in range(LIMIT_ROWS):
                total += t[side, k, i] * nu[side, k, i]
    return total / t.size
