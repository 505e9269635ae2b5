"""Riccati solver: it finds the active limits, and solves the rest by Riccati sweeps (sweep.py).

The dual y of a hard row has no bound. A soft row may be exceeded at its penalty for each unit, so that
-penalty <= y <= penalty:  at the bound the row is exceeded. Two methods find y, the second where the first does not
converge:

    active set       Rows whose dual y was not zero in the last solve are held by a large weight: weight = RHO,
                     linear = y - RHO b for each such row g = b. Then y + RHO (g - b) is its dual. A row whose dual has
                     the wrong sign is released, a violated row is added, and the sweep is repeated (a primal-dual
                     active set method: Hintermueller, Ito & Kunisch 2002; with the multipliers of Hestenes 1969). A
                     soft row whose dual would be larger than its penalty is exceeded: weight = 0, linear = +-penalty.
                     If the last cycle's set is still right, one sweep is enough.
    interior point   On both sides of a row let r be the distance beyond the bound, nu > 0 the dual, t > 0 a slack and
                     e >= 0 the excess: r = e - t. Newton steps towards  t nu = sigma mu  and  e (penalty - nu) =
                     sigma mu  give each side a weight, and keep its numbers positive while both products go to zero
                     (Rao, Wright & Rawlings 1998). ``DUAL_REGULARISATION`` bounds the weights, which would otherwise
                     grow until rounding ends the progress; it does not move the solution (a proximal method of
                     multipliers: Friedlander & Orban 2012). It takes five to twenty sweeps from any start. When it
                     names the same active rows twice, the active-set method finishes the solve, exactly.

The result is exact to 1e-7 of a row's unit. The method is the solver ``riccati``, which checks the optimality
conditions of its result and hands a problem that fails to OSQP. The solver ``osqp`` takes the result as a first guess,
and has only to check its residuals.

Arguments of the kernels in this file:

    p        problem
    work     workspace of the sweeps
    active   (N+1, M) sign of each row's dual, times ``BEYOND`` if the row is exceeded, 0 if the row is not active
    y        (N+1, M) duals of the rows
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ltv_mpc.control import shooting_grid
from ltv_mpc.control.config import ResolvedConfig
from ltv_mpc.control.ocp.problem import Problem, is_finite, optimality_error
from ltv_mpc.control.solvers.interface import Result, Solver
from ltv_mpc.control.solvers.sweep import Sweep, sweep
from ltv_mpc.jit import jit
from ltv_mpc.messages import Array, Solve, SolveStatus

RHO = 1e6
"""Weight of a row that is held, against a curvature of about 1: its error is the change of its dual / RHO."""

BEYOND = 2.0
"""Magnitude of ``active`` for a soft row that is exceeded: its dual is its penalty."""

VIOLATION_TOLERANCE = 1e-7
"""Smallest violation that counts, in units of the row. Rounding, times RHO, is a hundred times smaller."""

DUAL_SIGN_TOLERANCE = 1e-7
"""Smallest dual of the wrong sign that counts, in units of the cost."""

HELD_ROW_TOLERANCE = 1e-7
"""Largest error of a row that is held. OSQP moves away from a guess with larger ones, and returns slowly."""

MAX_OPTIMALITY_ERROR = 1e-5
"""Largest violation of the optimality conditions of a result that counts as solved, in units of the problem."""

FIRST_SWEEPS, LATER_SWEEPS = 3, 3
"""Limits of the active-set sweeps: with the last solve's rows, and with those that the interior point names."""

MIN_SIGMA = 0.02
"""Smallest centring parameter sigma: a step aims at this part of the mean product mu of slack and dual. After a step of
the length s it is (1 - s)^2, because a short step shows a point far from the central path.
"""

INITIAL_SLACK, INITIAL_DUAL = 1.0, 30.0
"""Smallest slack, and dual, at which the interior point starts. Duals reach 500, and a start below them is what makes
steps short. Where the nominal trajectory already exceeds a soft row, the product of both starts at what this costs:
below it, two zones that leave no room between them took more than ``MAX_SWEEPS``.
"""

DUAL_REGULARISATION, LAST_REGULARISATION = 1e-8, 1e-7
"""A dual that a step changes by d counts as a violation of this times d: the largest weight is its inverse.

Where rows nearly depend on each other, as two half-planes at a wall do, their duals grow in each sweep by the violation
over this, until one of the rows is released: with 1e-7 that took up to 130 sweeps. Rounding, times the weight, is
smaller with the second value. It is taken once all products are zero and the result is not exact.
"""

MU_IDENTIFIED, MU_CONVERGED, WHOLE_STEP = 1e-3, 1e-11, 0.9
"""Mean product of slack and dual below which they show which rows are active; below which the point may be the solution
itself, to rounding; and smallest step for the latter. It ends a solve in which a limit is just reached with a dual of
zero: no set is right there. No step aims far below the second: a slack would be rounded to zero.
"""

TO_BOUNDARY = 0.995
"""Largest part of the step to where a slack or a dual would be zero."""

MAX_SWEEPS = 60
"""Limit of sweeps. Rows that nearly depend on each other take 20 to 36, other problems seen at most 30."""

FAILED, NOT_CONVERGED, CONVERGED = -1, 0, 1
"""Outcome of a method: no usable result; nearly a solution; the solution."""


class RiccatiSolver:
    """Riccati method as a solver of the controller, with another solver for problems that it does not solve."""

    max_error = MAX_OPTIMALITY_ERROR
    """Largest optimality error of a result that is used."""

    def __init__(self, config: ResolvedConfig, other: Solver | None = None) -> None:
        """Allocate nothing: the first problem gives the sizes.

        Parameters
        ----------
        config : knots and limit of iterations.
        other : solves the problems whose result here violates the optimality conditions. It also solves the first
            problem, so that it is compiled and set up before it is needed. None: such a problem is not solved.
        """
        self._other, self._other_is_ready = other, False
        self._max_sweeps, self._knots = config.max_iterations, config.knots
        self._shift = math.nan
        self._problem: Problem | None = None
        self._duals = np.zeros((0, 0))

    def shift_warm_start(self, stages: float) -> None:
        """Move the duals with the plan; the last ones are held.

        Parameters
        ----------
        stages : by how many first stages the next problem's knots lie later than the last one's.
        """
        self._shift = stages

    def reset_warm_start(self) -> None:
        """Start the next solve with no active row."""
        self._shift = math.nan

    def build(self, problem: Problem) -> None:
        """Keep the problem: the sweeps read it as it is.

        Parameters
        ----------
        problem : is read by ``solve``.
        """
        if self._duals.shape != problem.low.shape:
            self._duals, self._work = np.zeros(problem.low.shape), Sweep.empty(problem)
            self.reset_warm_start()
            if self._other is not None:
                self._other.build(problem)  # its pattern, too, is that of the first problem
        self._problem = problem

    def update(self) -> None:
        """Do nothing: there is no workspace to update."""

    def solve(self) -> Result:
        """Solve the problem (see ``Solver``)."""
        assert self._problem is not None, "build() must be called before solve()"
        outcome, sweeps, violation, error = solve_from(
            self._problem, self._work, self._knots, self._shift, self._max_sweeps, self._duals
        )
        solved = outcome == CONVERGED and error <= self.max_error
        if self._other is not None and not (solved and self._other_is_ready):
            result = self._hand_over(self._other)
            if not solved:
                self._shift = math.nan if outcome == FAILED else 0.0
                return result
        if outcome == FAILED:
            self.reset_warm_start()
            finite = is_finite(self._problem)
            why = "the cost is singular: it does not determine the inputs" if finite else "the problem is not finite"
            status = SolveStatus.FAILED if finite else SolveStatus.NON_FINITE
            return Result(np.zeros_like(self._work.z), Solve(status=status, iterations=sweeps, why=why))
        self._shift = 0.0
        why = "" if solved else f"optimality error {error:.1e} after {sweeps} Riccati sweeps"
        status = SolveStatus.SOLVED if solved else SolveStatus.ITERATION_LIMIT
        solve = Solve(status=status, iterations=sweeps, primal_residual=violation, dual_residual=error, why=why)
        return Result(self._work.z.copy(), solve)

    def _hand_over(self, other: Solver) -> Result:
        """Return the other solver's result of the same problem, from no warm start."""
        assert self._problem is not None
        self._other_is_ready = True
        other.reset_warm_start()
        other.build(self._problem)
        other.update()
        return other.solve()


@jit
def solve_from(
    p: Problem, work: Sweep, t: Array, stages: float, max_sweeps: int, y: Array
) -> tuple[int, int, float, float]:
    """Solve a problem from the duals of an earlier one.

    Parameters
    ----------
    p : problem.
    work : is overwritten; its z is the solution.
    t : (N+1,) knots in first stages.
    stages : by how many first stages the knots of the earlier problem lie earlier; NaN if there is none.
    max_sweeps : limit of sweeps; the solve can take two more.
    y : (N+1, M) duals of the earlier problem; overwritten with those of this one.

    Returns
    -------
    Outcome, number of sweeps and largest violation, as ``solve``; then ``optimality_error``.
    """
    shift_duals(y, t, stages)
    outcome, sweeps, violation = solve(p, work, max_sweeps, y)
    return outcome, sweeps, violation, optimality_error(p, work.z, y)


@jit
def shift_duals(y: Array, t: Array, stages: float) -> None:
    """Shift duals to knots that lie later, or set them to zero.

    Parameters
    ----------
    y : (N+1, M) duals; overwritten.
    t : (N+1,) knots in first stages.
    stages : by how many first stages the new knots lie later; NaN: set the duals to zero.
    """
    if np.isnan(stages):
        y[:, :] = 0.0
    elif stages != 0.0:
        shooting_grid.shift(y, t, stages)


@jit
def solve(p: Problem, work: Sweep, max_sweeps: int, y: Array) -> tuple[int, int, float]:
    """Solve a problem.

    Parameters
    ----------
    p, work : as at the head of this file; ``work`` is overwritten, and its z is the solution.
    max_sweeps : limit of sweeps; the solve can take two more.
    y : (N+1, M) duals of the last solve, which show the first active set; overwritten with those of this one.

    Returns
    -------
    FAILED, NOT_CONVERGED or CONVERGED; number of sweeps; largest violation of the hard rows.
    """
    active = _active_rows(p, y)
    outcome, sweeps = _active_set(p, work, active, FIRST_SWEEPS, y)
    if outcome == NOT_CONVERGED:
        outcome, more = _interior_point(p, work, active, max_sweeps - sweeps, y)
        sweeps += more
    if outcome == FAILED:
        work.z[:, :] = 0.0
        y[:, :] = 0.0
        return outcome, sweeps, 0.0
    violation = 0.0
    for k in range(y.shape[0]):
        for i in range(y.shape[1]):
            if np.isinf(p.penalty[k, i]):
                violation = max(violation, work.g[k, i] - p.high[k, i], p.low[k, i] - work.g[k, i])
    return outcome, sweeps, violation


@jit
def _active_rows(p: Problem, y: Array) -> Array:
    """Return which rows the duals show to be active: ``active``."""
    active = np.sign(y)
    for k in range(y.shape[0]):
        for i in range(y.shape[1]):
            if np.isinf(p.high[k, i] if y[k, i] > 0.0 else p.low[k, i]):
                active[k, i] = 0.0
            elif abs(y[k, i]) >= p.penalty[k, i] - DUAL_SIGN_TOLERANCE:
                active[k, i] *= BEYOND
    return active


@jit
def _active_set(p: Problem, work: Sweep, active: Array, max_sweeps: int, y: Array) -> tuple[int, int]:
    """Solve by the active-set method; return its outcome and the number of sweeps."""
    for sweeps in range(1, max_sweeps + 1):
        for k in range(active.shape[0]):
            for i in range(active.shape[1]):
                sign = active[k, i]
                work.weight[k, i] = work.linear[k, i] = 0.0
                if abs(sign) == 1.0:
                    work.weight[k, i] = RHO
                    work.linear[k, i] = y[k, i] - RHO * (p.high[k, i] if sign > 0.0 else p.low[k, i])
                elif sign != 0.0:
                    work.linear[k, i] = np.sign(sign) * p.penalty[k, i]
        if not sweep(p, work):
            return FAILED, sweeps
        if not _update_active(p, work, active, y):
            return CONVERGED, sweeps
    return NOT_CONVERGED, max_sweeps


@jit
def _update_active(p: Problem, work: Sweep, active: Array, y: Array) -> bool:
    """Update the active rows and their duals after a sweep; return True if they are not those of the solution yet."""
    changed = False
    for k in range(active.shape[0]):
        for i in range(active.shape[1]):
            held, cap, g = active[k, i], p.penalty[k, i], work.g[k, i]
            low, high = p.low[k, i] - VIOLATION_TOLERANCE, p.high[k, i] + VIOLATION_TOLERANCE
            dual = work.weight[k, i] * g + work.linear[k, i]
            now = held
            if abs(held) == 1.0 and dual * held >= -DUAL_SIGN_TOLERANCE:
                if abs(dual) > cap + DUAL_SIGN_TOLERANCE:
                    now, dual = BEYOND * held, held * cap
                else:
                    changed |= abs(dual - y[k, i]) > RHO * HELD_ROW_TOLERANCE
            elif abs(held) == BEYOND:
                if (held > 0.0 and g < high) or (held < 0.0 and g > low):
                    now = np.sign(held)
            else:
                now = 1.0 if g > high else -1.0 if g < low else 0.0
                dual = 0.0
            y[k, i] = dual
            if now != held:
                active[k, i], changed = now, True
    return changed


class _Barrier(NamedTuple):
    """Numbers of the upper bounds (0) and of the lower ones (1), and their steps; nu = 0 where there is no bound."""

    t: Array  # (2, N+1, M) slacks
    e: Array  # excesses, 0 for a hard row
    nu: Array  # duals
    room: Array  # penalty - nu, kept apart: the difference would be lost in the rounding of a penalty of 1e4
    dt: Array
    de: Array
    dnu: Array


@jit
def _interior_point(p: Problem, work: Sweep, active: Array, max_sweeps: int, y: Array) -> tuple[int, int]:
    """Solve by the interior-point method until the active set is known; return the outcome and the number of sweeps."""
    barrier = _initial_barrier(p)
    sweeps, step, mu, regularisation = 0, 1.0, _mean_product(p, barrier), DUAL_REGULARISATION
    failed = False
    while sweeps < max_sweeps:
        aim = max(max(MIN_SIGMA, (1.0 - step) ** 2) * mu, 0.1 * MU_CONVERGED)
        _set_barrier_terms(p, barrier, aim, regularisation, work)
        sweeps += 1
        if not sweep(p, work):
            return FAILED, sweeps
        primal, dual = _find_step(p, barrier, aim, regularisation, work)
        _take_step(barrier, primal, dual)
        same = _name_active(barrier, active)
        step, mu = min(primal, dual), _mean_product(p, barrier)
        if not np.isfinite(mu):
            return FAILED, sweeps
        if mu < MU_CONVERGED and step > WHOLE_STEP:
            for k in range(y.shape[0]):  # the duals that belong to the inputs of the last sweep
                for i in range(y.shape[1]):
                    y[k, i] = work.weight[k, i] * work.g[k, i] + work.linear[k, i]
            if optimality_error(p, work.z, y) < MAX_OPTIMALITY_ERROR:
                return CONVERGED, sweeps
            regularisation = LAST_REGULARISATION
        failed = failed and same  # the active-set method, with these rows and earlier duals
        if mu < MU_IDENTIFIED and same and (mu < MU_CONVERGED or not failed):
            _duals(barrier.nu, y)
            outcome, more = _active_set(p, work, active, LATER_SWEEPS, y)
            sweeps += more
            if outcome != NOT_CONVERGED:
                return outcome, sweeps
            failed = True
    _duals(barrier.nu, y)
    return NOT_CONVERGED, sweeps


@jit
def _bound(p: Problem, side: int, k: int, i: int) -> float:
    """Return the bound of a side as an upper bound of  side's sign times g; infinite if there is none."""
    return float(p.high[k, i] if side == 0 else -p.low[k, i])


@jit
def _initial_barrier(p: Problem) -> _Barrier:
    """Return the numbers at which the interior point starts."""
    K, R = p.low.shape
    t, e, nu, room = np.ones((2, K, R)), np.zeros((2, K, R)), np.zeros((2, K, R)), np.zeros((2, K, R))
    dt, de, dnu = np.zeros((2, K, R)), np.zeros((2, K, R)), np.zeros((2, K, R))
    product = INITIAL_SLACK * INITIAL_DUAL
    for k in range(K):
        for i in range(R):
            if not np.isinf(p.penalty[k, i]):
                product = max(product, p.penalty[k, i] * max(p.low[k, i], -p.high[k, i]))
    for side in range(2):
        for k in range(K):
            for i in range(R):
                within, cap = _bound(p, side, k, i), p.penalty[k, i]
                if np.isinf(within):
                    continue
                t[side, k, i] = max(within, INITIAL_SLACK)
                nu[side, k, i] = min(product / t[side, k, i], 0.5 * cap)
                room[side, k, i] = cap - nu[side, k, i]
                if not np.isinf(cap):
                    e[side, k, i] = product / room[side, k, i]
    return _Barrier(t, e, nu, room, dt, de, dnu)


@jit
def _set_barrier_terms(p: Problem, barrier: _Barrier, aim: float, regularisation: float, work: Sweep) -> None:
    """Set weight and linear of the next sweep, of both sides of each row."""
    t, e, nu = barrier.t, barrier.e, barrier.nu
    for k in range(t.shape[1]):
        for i in range(t.shape[2]):
            weight = linear = 0.0
            for side in range(2):
                bound, x, room = _bound(p, side, k, i), nu[side, k, i], barrier.room[side, k, i]
                if np.isinf(bound):
                    continue
                w = 1.0 / (t[side, k, i] / x + e[side, k, i] / room + regularisation)
                sign = 1.0 if side == 0 else -1.0
                weight += w
                linear += sign * (x + w * (aim / x - aim / room) - w * bound)
            work.weight[k, i], work.linear[k, i] = weight, linear


@jit
def _find_step(p: Problem, barrier: _Barrier, aim: float, regularisation: float, work: Sweep) -> tuple[float, float]:
    """Compute the steps; return the fractions of slacks' and duals' steps that keep all numbers positive."""
    primal = dual = 1.0
    for side in range(2):
        for k in range(work.g.shape[0]):
            for i in range(work.g.shape[1]):
                t, e, nu = barrier.t[side, k, i], barrier.e[side, k, i], barrier.nu[side, k, i]
                room, bound = barrier.room[side, k, i], _bound(p, side, k, i)
                if np.isinf(bound):
                    continue
                beyond = (work.g[k, i] if side == 0 else -work.g[k, i]) - bound
                # e + de - (t + dt) = beyond - regularisation dnu, and both products are the aim to first order
                dnu = (beyond + aim / nu - aim / room) / (t / nu + e / room + regularisation)
                dt, de = aim / nu - t - t * dnu / nu, aim / room - e + e * dnu / room
                barrier.dt[side, k, i], barrier.de[side, k, i], barrier.dnu[side, k, i] = dt, de, dnu
                if dt < 0.0:
                    primal = min(primal, -TO_BOUNDARY * t / dt)
                if de < 0.0:
                    primal = min(primal, -TO_BOUNDARY * e / de)
                if dnu < 0.0:
                    dual = min(dual, -TO_BOUNDARY * nu / dnu)
                else:
                    dual = min(dual, TO_BOUNDARY * room / dnu)
    return primal, dual


@jit
def _take_step(barrier: _Barrier, primal: float, dual: float) -> None:
    """Take the step."""
    for i in range(barrier.t.size):
        barrier.t.flat[i] += primal * barrier.dt.flat[i]
        barrier.e.flat[i] += primal * barrier.de.flat[i]
        barrier.nu.flat[i] += dual * barrier.dnu.flat[i]
        barrier.room.flat[i] -= dual * barrier.dnu.flat[i]


@jit
def _name_active(barrier: _Barrier, active: Array) -> bool:
    """Update the active rows; return True if they are the same as before."""
    t, e, nu, room = barrier.t, barrier.e, barrier.nu, barrier.room
    same = True
    for k in range(active.shape[0]):
        for i in range(active.shape[1]):
            now = 0.0
            if nu[0, k, i] > t[0, k, i]:
                now = BEYOND if e[0, k, i] > room[0, k, i] else 1.0
            elif nu[1, k, i] > t[1, k, i]:
                now = -BEYOND if e[1, k, i] > room[1, k, i] else -1.0
            if now != active[k, i]:
                active[k, i], same = now, False
    return same


@jit
def _duals(nu: Array, y: Array) -> None:
    """Compute y (N+1, M) from the duals of both sides."""
    for k in range(y.shape[0]):
        for i in range(y.shape[1]):
            y[k, i] = nu[0, k, i] - nu[1, k, i]


@jit
def _mean_product(p: Problem, barrier: _Barrier) -> float:
    """Return mu, the mean product of slack and dual, and of excess and what its dual is below its penalty."""
    t, e, nu = barrier.t, barrier.e, barrier.nu
    total, count = 0.0, 1
    for side in range(2):
        for k in range(t.shape[1]):
            for i in range(t.shape[2]):
                if np.isinf(_bound(p, side, k, i)):
                    continue
                total += t[side, k, i] * nu[side, k, i]
                count += 1
                if not np.isinf(p.penalty[k, i]):
                    total += e[side, k, i] * barrier.room[side, k, i]
                    count += 1
    return float(total / count)
