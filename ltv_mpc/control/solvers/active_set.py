"""Active-set method on a problem of stages: rows that are held, and Riccati sweeps for the rest.

Rows whose dual y was not zero in the last solve are held by a large weight: weight = RHO, linear = y - RHO b for each
such row g = b. Then y + RHO (g - b) is its dual. A row whose dual has the wrong sign is released, a violated row is
added, and the sweep is repeated (a primal-dual active set method: Hintermueller, Ito & Kunisch 2002; with the
multipliers of Hestenes 1969). A soft row whose dual would be larger than its penalty is exceeded: weight = 0,
linear = +-penalty. If the last cycle's set is still right, one sweep is enough.

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
from ltv_mpc.jit import jit
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
    for k in range(y.shape[0]):
        for i in range(y.shape[1]):
            if np.isinf(p.high[k, i] if y[k, i] > 0.0 else p.low[k, i]):
                active[k, i] = 0.0
            elif abs(y[k, i]) >= p.penalty[k, i] - DUAL_SIGN_TOLERANCE:
                active[k, i] *= BEYOND
    return active


@jit
def active_set(p: Problem, work: Sweep, active: Array, max_sweeps: int, y: Array) -> tuple[int, int]:
    """Solve by the active-set method; return its outcome and the number of sweeps.

    Parameters
    ----------
    p, work, active, y : as at the head of this file; active and y are overwritten.
    max_sweeps : limit of sweeps.
    """
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
