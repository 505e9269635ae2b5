"""Slew: largest change of the commands from one knot to the next, hard.

    |U_k - U_(k-1)| <= slew h_k

Commands are linear between knots, so |dF/dt| <= slew everywhere, and also at the junction of two plans, because U_0 is
the command in force there.
"""

from __future__ import annotations

from ltv_mpc.control.linearisation import Linearisation
from ltv_mpc.control.ocp.problem import Problem
from ltv_mpc.control.problem_data import CHANGES, Objective, stage_length
from ltv_mpc.jit import jit
from ltv_mpc.messages import Array

ROW = 2


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
            largest, change = stage_length(t, k) * o.max_change[i], U[k, i] - U[k - 1, i]
            p.G[k - 1, ROW + i, CHANGES + i] = 1.0
            p.low[k - 1, ROW + i], p.high[k - 1, ROW + i] = (-largest - change) / F[i], (largest - change) / F[i]
