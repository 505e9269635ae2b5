"""Box: smallest and largest thrust of port and starboard, hard.

    low <= U_k <= high

A start outside the box (a limit that was just lowered) returns into it at the slew limit (``command_bounds``).
"""

from __future__ import annotations

from ltv_mpc.control.horizon_limits import command_bounds
from ltv_mpc.control.linearisation import Linearisation
from ltv_mpc.control.ocp.problem import Problem
from ltv_mpc.control.problem_data import COMMANDS, Objective
from ltv_mpc.jit import jit
from ltv_mpc.messages import Array

ROW = 0


@jit
def add(p: Problem, lin: Linearisation, target: Array, o: Objective) -> None:
    """Add the rows.

    Parameters
    ----------
    p, lin, target, o : as in ``ocp/terms``.
    """
    U, F, t = lin.U, o.thrust_scale, o.t
    for k in range(1, len(U)):
        for i in range(2):
            low, high = command_bounds(U[0, i], t[k] * o.max_change[i], o.low[i], o.high[i])
            p.G[k, ROW + i, COMMANDS + i] = 1.0
            p.low[k, ROW + i], p.high[k, ROW + i] = (low - U[k, i]) / F[i], (high - U[k, i]) / F[i]
