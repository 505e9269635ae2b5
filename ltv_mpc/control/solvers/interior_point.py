"""Interior-point method on a problem of stages, by Riccati sweeps, until the active rows are known.

On both sides of a row let r be the distance beyond the bound, nu > 0 the dual, t > 0 a slack and e >= 0 the excess:
r = e - t. Newton steps towards  t nu = sigma mu  and  e (penalty - nu) = sigma mu  give each side a weight, and keep
its numbers positive while both products go to zero (Rao, Wright & Rawlings 1998). ``DUAL_REGULARISATION`` bounds the
weights, which would otherwise grow until rounding ends the progress; it does not move the solution (a proximal method
of multipliers: Friedlander & Orban 2012). It takes five to twenty sweeps from any start. When it names the same active
rows twice, the active-set method finishes the solve, exactly.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ltv_mpc.control.ocp.problem import Problem, optimality_error
from ltv_mpc.control.solvers.active_set import BEYOND, CONVERGED, FAILED, NOT_CONVERGED, active_set
from ltv_mpc.control.solvers.sweep import Sweep, sweep
from ltv_mpc.jit import copy_to, jit
from ltv_mpc.messages import Array

MAX_OPTIMALITY_ERROR = 1e-5
"""Largest violation of the optimality conditions of a result that counts as solved, in units of the problem."""

LATER_SWEEPS = 3
"""Limit of the active-set sweeps with the rows that the interior point names."""

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


class _Barrier(NamedTuple):
    """Numbers of the sides that have a bound: the upper ones (0) and the lower ones (1) of rows (2, N+1, M)."""

    bound: Array  # as an upper bound of  side's sign times g; inf: there is none
    cap: Array  # penalty
    t: Array  # slacks
    e: Array  # excesses, 0 for a hard row
    nu: Array  # duals, 0 where there is no bound
    room: Array  # penalty - nu, kept apart: the difference would be lost in the rounding of a penalty of 1e4
    dt: Array  # steps
    de: Array
    dnu: Array


@jit
def interior_point(p: Problem, work: Sweep, active: Array, max_sweeps: int, y: Array) -> tuple[int, int]:
    """Solve by the interior-point method until the active set is known; return the outcome and the number of sweeps.

    Parameters
    ----------
    p, work, active, y : as in active_set.py; active and y are overwritten.
    max_sweeps : limit of sweeps; the active-set method can take a few more.
    """
    barrier = _initial_barrier(p)
    sweeps, step, regularisation, failed = 0, 1.0, DUAL_REGULARISATION, False
    _, mu = _advance(barrier, 0.0, 0.0, active)
    while sweeps < max_sweeps:
        aim = max(max(MIN_SIGMA, (1.0 - step) ** 2) * mu, 0.1 * MU_CONVERGED)
        _set_barrier_terms(barrier, aim, regularisation, work)
        sweeps += 1
        if not sweep(p, work):
            return FAILED, sweeps
        primal, dual = _find_step(barrier, aim, regularisation, work)
        same, mu = _advance(barrier, primal, dual, active)
        step = min(primal, dual)
        if not np.isfinite(mu):
            return FAILED, sweeps
        if mu < MU_CONVERGED and step > WHOLE_STEP:
            for i in range(y.size):  # the duals that belong to the inputs of the last sweep
                y.flat[i] = work.weight.flat[i] * work.g.flat[i] + work.linear.flat[i]
            if optimality_error(p, work.z, y) < MAX_OPTIMALITY_ERROR:
                return CONVERGED, sweeps
            regularisation = LAST_REGULARISATION
        failed = failed and same  # the active-set method, with these rows and earlier duals
        if mu < MU_IDENTIFIED and same and (mu < MU_CONVERGED or not failed):
            copy_to(y, barrier.nu[0] - barrier.nu[1])
            outcome, more = active_set(p, work, active, LATER_SWEEPS, y)
            sweeps += more
            if outcome != NOT_CONVERGED:
                return outcome, sweeps
            failed = True
    copy_to(y, barrier.nu[0] - barrier.nu[1])
    return NOT_CONVERGED, sweeps


@jit
def _initial_barrier(p: Problem) -> _Barrier:
    """Return the numbers at which the interior point starts."""
    rows, shape = p.low.size, (2, *p.low.shape)
    bound, cap, t, e = np.empty(shape), np.empty(shape), np.ones(shape), np.zeros(shape)
    nu, room, dt, de, dnu = np.zeros(shape), np.zeros(shape), np.zeros(shape), np.zeros(shape), np.zeros(shape)
    product = INITIAL_SLACK * INITIAL_DUAL
    for i in range(rows):
        bound.flat[i], bound.flat[rows + i] = p.high.flat[i], -p.low.flat[i]
        cap.flat[i] = cap.flat[rows + i] = p.penalty.flat[i]
        if not np.isinf(p.penalty.flat[i]):
            product = max(product, p.penalty.flat[i] * max(p.low.flat[i], -p.high.flat[i]))
    for i in range(bound.size):
        if not np.isinf(bound.flat[i]):
            t.flat[i] = max(bound.flat[i], INITIAL_SLACK)
            nu.flat[i] = min(product / t.flat[i], 0.5 * cap.flat[i])
            room.flat[i] = cap.flat[i] - nu.flat[i]
            e.flat[i] = 0.0 if np.isinf(cap.flat[i]) else product / room.flat[i]
    return _Barrier(bound, cap, t, e, nu, room, dt, de, dnu)


@jit
def _set_barrier_terms(barrier: _Barrier, aim: float, regularisation: float, work: Sweep) -> None:
    """Set weight and linear of the next sweep, of both sides of each row."""
    bound, t, e, nu, room = barrier.bound, barrier.t, barrier.e, barrier.nu, barrier.room
    rows = work.weight.size
    for i in range(rows):
        work.weight.flat[i] = work.linear.flat[i] = 0.0
    for i in range(bound.size):
        if not np.isinf(bound.flat[i]):
            row, sign, x = i % rows, 1.0 if i < rows else -1.0, nu.flat[i]
            w = 1.0 / (t.flat[i] / x + e.flat[i] / room.flat[i] + regularisation)
            work.weight.flat[row] += w
            work.linear.flat[row] += sign * (x + w * (aim / x - aim / room.flat[i] - bound.flat[i]))


@jit
def _find_step(barrier: _Barrier, aim: float, regularisation: float, work: Sweep) -> tuple[float, float]:
    """Compute the steps; return the fractions of slacks' and duals' steps that keep all numbers positive."""
    rows, primal, dual = work.g.size, 1.0, 1.0
    for i in range(barrier.bound.size):
        bound, room = barrier.bound.flat[i], barrier.room.flat[i]
        t, e, nu = barrier.t.flat[i], barrier.e.flat[i], barrier.nu.flat[i]
        if np.isinf(bound):
            continue
        beyond = (1.0 if i < rows else -1.0) * work.g.flat[i % rows] - bound
        # e + de - (t + dt) = beyond - regularisation dnu, and both products are the aim to first order
        dnu = (beyond + aim / nu - aim / room) / (t / nu + e / room + regularisation)
        dt, de = aim / nu - t - t * dnu / nu, aim / room - e + e * dnu / room
        barrier.dt.flat[i], barrier.de.flat[i], barrier.dnu.flat[i] = dt, de, dnu
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
def _advance(barrier: _Barrier, primal: float, dual: float, active: Array) -> tuple[bool, float]:
    """Take a step, and update the active rows; return True if they are the same as before, and the mean product mu.

    The mean is that of the products of slack and dual, and of excess and what its dual is below its penalty.
    """
    t, e, nu, room, rows = barrier.t, barrier.e, barrier.nu, barrier.room, active.size
    total, count, same = 0.0, 1, True
    for i in range(t.size):
        t.flat[i] += primal * barrier.dt.flat[i]
        e.flat[i] += primal * barrier.de.flat[i]
        nu.flat[i] += dual * barrier.dnu.flat[i]
        room.flat[i] -= dual * barrier.dnu.flat[i]
        if not np.isinf(barrier.bound.flat[i]):
            total += t.flat[i] * nu.flat[i]
            count += 1
            if not np.isinf(barrier.cap.flat[i]):
                total += e.flat[i] * room.flat[i]
                count += 1
    for row in range(rows):
        now = 0.0
        i = row if nu.flat[row] > t.flat[row] else rows + row
        if nu.flat[i] > t.flat[i]:
            now = (BEYOND if e.flat[i] > room.flat[i] else 1.0) * (1.0 if i < rows else -1.0)
        if now != active.flat[row]:
            active.flat[row], same = now, False
    return same, float(total / count)
