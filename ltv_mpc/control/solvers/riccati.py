"""Riccati method: it finds the active limits, and solves the rest by Riccati sweeps (sweep.py).

The dual y of a hard row has no bound. A soft row may be exceeded at its penalty for each unit, so that
-penalty <= y <= penalty:  at the bound the row is exceeded. Two methods find y, the second where the first does not
converge: from the rows that were active in the last solve (active_set.py), and from any start (interior_point.py).

The result is exact to 1e-7 of a row's unit.
"""

from __future__ import annotations

from ltv_mpc.control import shooting_grid
from ltv_mpc.control.ocp.problem import Problem, roll_out, row_values
from ltv_mpc.control.solvers.active_set import FAILED, NOT_CONVERGED, active_rows, active_set
from ltv_mpc.control.solvers.interior_point import interior_point
from ltv_mpc.control.solvers.sweep import Sweep
from ltv_mpc.jit import copy_to, jit
from ltv_mpc.messages import Array

FIRST_SWEEPS = 6
"""Limit of the active-set sweeps with the last solve's rows."""

MAX_SWEEPS = 60
"""Limit of sweeps; problems seen take at most 36."""

NOT_ACTIVE = 1e-9
"""Magnitude below which a dual is zero up to rounding."""


@jit
def solve(p: Problem, work: Sweep, t: Array, shift: float, y: Array) -> tuple[int, int]:
    """Solve a problem from the duals of an earlier one.

    Parameters
    ----------
    p : problem.
    work : is overwritten; its z is the solution.
    t : (N+1,) knots in first stages.
    shift : by how many first stages the knots of the earlier problem lie earlier; NaN if there is none.
    y : (N+1, M) duals of the earlier problem, which show the first active set; overwritten with those of this one.

    Returns
    -------
    FAILED, NOT_CONVERGED or CONVERGED, and the number of sweeps: at most ``MAX_SWEEPS`` and two more. FAILED: the
    duals are those of the earlier problem, and z follows from no input.
    """
    shooting_grid.shift(y, t, shift)
    for i in range(y.size):
        if abs(y.flat[i]) <= NOT_ACTIVE:
            y.flat[i] = 0.0
    active, before = active_rows(p, y), y.copy()
    outcome, sweeps = active_set(p, work, active, FIRST_SWEEPS, y)
    if outcome == NOT_CONVERGED:
        outcome, more = interior_point(p, work, active, MAX_SWEEPS - sweeps, y)
        sweeps += more
    if outcome == FAILED:
        copy_to(y, before)
        work.z[:, :] = 0.0
        roll_out(p, work.z)
        row_values(p, work.z, work.g)
    return outcome, sweeps
