"""Active-set method on a problem of stages: rows that are held, and Riccati sweeps for the rest.

A row g = b is held by a large weight: weight = RHO, linear = y - RHO b. Then y + RHO (g - b) is its dual. A soft row
whose dual would be larger than its penalty is exceeded: weight = 0, linear = +-penalty. So a sweep minimises the
augmented Lagrangian as long as no row changes its part: a row whose dual has the wrong sign is released, a violated one
is held, one whose dual passes its penalty is exceeded (a Newton method on a convex function that is quadratic in
pieces; Hermans, Themelis & Patrinos 2019). If the last cycle's set is still right, one sweep is enough. Nothing keeps
the method from going in circles: the interior point (interior_point.py) takes over after a few sweeps.

Arguments of the kernels in this file:

    p        problem
    work     workspace of the sweeps
    active   (N+1, M) sign of each row's dual, times ``BEYOND`` if the row is exceeded, 0 if the row is not active
    y        (N+1, M) duals of the rows
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.control.ocp.problem import Problem
from ltv_mpc.control.solvers.sweep import Sweep, sweep
from ltv_mpc.jit import jit, jit_outlined
from ltv_mpc.messages import Array

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

MANY_WRONG = 12
"""Wrong rows after a sweep with which the method gives up: the interior point is faster from there."""

FAILED, NOT_CONVERGED, CONVERGED = -1, 0, 1
"""Outcome of a method: no usable result; nearly a solution; the solution."""


@jit
def active_rows(p: Problem, y: Array) -> Array:
    """Return which rows the duals show to be active: ``active``.

    Parameters
    ----------
    p, y : as at the head of this file.
    """
    active = np.sign(y)
    for i in range(y.size):
        if np.isinf(p.high.flat[i] if y.flat[i] > 0.0 else p.low.flat[i]):
            active.flat[i] = 0.0
        elif abs(y.flat[i]) >= p.penalty.flat[i] - DUAL_SIGN_TOLERANCE:
            active.flat[i] *= BEYOND
    return active


@jit_outlined
def active_set(p: Problem, work: Sweep, active: Array, max_sweeps: int, y: Array) -> tuple[int, int]:
    """Solve by the active-set method; return its outcome and the number of sweeps.

    Parameters
    ----------
    p, work, active, y : as at the head of this file; active and y are overwritten.
    max_sweeps : limit of sweeps.
    """
    for sweeps in range(1, max_sweeps + 1):
        last = _hold(p, work, active, y)
        if not sweep(p, work, len(p.f) if sweeps == 1 else last):
            return FAILED, sweeps
        wrong = _update_active(p, work.g, y, active)
        if wrong == 0 and not _update_duals(work, y):
            return CONVERGED, sweeps
        if wrong > MANY_WRONG:
            return NOT_CONVERGED, sweeps
    return NOT_CONVERGED, max_sweeps


@jit
def _hold(p: Problem, work: Sweep, active: Array, y: Array) -> int:
    """Set weight and linear of all rows, and return the last stage in which one changes."""
    last = 0
    for k in range(active.shape[0]):
        for i in range(active.shape[1]):
            sign, weight, linear = active[k, i], 0.0, 0.0
            if abs(sign) == 1.0:
                weight = RHO
                linear = y[k, i] - RHO * (p.high[k, i] if sign > 0.0 else p.low[k, i])
            elif sign != 0.0:
                linear = np.sign(sign) * p.penalty[k, i]
            if weight != work.weight[k, i] or linear != work.linear[k, i]:
                work.weight[k, i], work.linear[k, i], last = weight, linear, k
    return last


@jit
def _update_active(p: Problem, g: Array, y: Array, active: Array) -> int:
    """Update the active rows by their values g, and return how many change."""
    changed = 0
    for i in range(active.size):
        held, cap = float(active.flat[i]), p.penalty.flat[i]
        above = y.flat[i] + RHO * (g.flat[i] - p.high.flat[i])
        below = y.flat[i] + RHO * (g.flat[i] - p.low.flat[i])
        now = held
        if held == 0.0:
            if above > RHO * VIOLATION_TOLERANCE:
                now = 1.0
            elif below < -RHO * VIOLATION_TOLERANCE:
                now = -1.0
        else:
            dual = above if held > 0.0 else -below
            if dual < -DUAL_SIGN_TOLERANCE:
                now = 0.0
            elif abs(held) == 1.0 and dual > cap + DUAL_SIGN_TOLERANCE:
                now = BEYOND * held
            elif abs(held) == BEYOND and dual < cap - DUAL_SIGN_TOLERANCE:
                now = float(np.sign(held))
        if now != held:
            active.flat[i] = now
            changed += 1
    return changed


@jit
def _update_duals(work: Sweep, y: Array) -> bool:
    """Set the duals to those of the last sweep; return True if the change of one leaves an error of its row."""
    largest = 0.0
    for i in range(y.size):
        dual = work.weight.flat[i] * work.g.flat[i] + work.linear.flat[i]
        if work.weight.flat[i] > 0.0:
            largest = max(largest, abs(dual - y.flat[i]))
        y.flat[i] = dual
    return largest > RHO * HELD_ROW_TOLERANCE
