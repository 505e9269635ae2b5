"""Thrust: commands of port and starboard at each knot.

1/2 r g_k |U_k / F|^2,    r = thrust, F the larger side of each thruster's box (N)
"""

from __future__ import annotations

from ltv_mpc.control.linearisation import Linearisation
from ltv_mpc.control.ocp.problem import Problem
from ltv_mpc.control.problem_data import COMMANDS, Objective, stage_length
from ltv_mpc.jit import jit
from ltv_mpc.messages import Array


@jit
def cost(X: Array, U: Array, C: Array, target: Array, o: Objective) -> float:
    """Return the value along a trajectory.

    Parameters
    ----------
    X, U, C, target, o : as in ``ocp/terms``.
    """
    total, F, t = 0.0, o.thrust_scale, o.t
    for k in range(1, len(U)):
        port, starboard = U[k, 0] / F[0], U[k, 1] / F[1]
        total += stage_length(t, k) * (port * port + starboard * starboard)
    return float(0.5 * o.thrust * total)


@jit
def add(p: Problem, lin: Linearisation, target: Array, o: Objective) -> None:
    """Add the quadratic model.

    Parameters
    ----------
    p, lin, target, o : as in ``ocp/terms``.
    """
    U, F, t = lin.U, o.thrust_scale, o.t
    for k in range(1, len(U)):
        weight = o.thrust * stage_length(t, k)
        for i in range(2):
            p.H[k, COMMANDS + i, COMMANDS + i] += weight
            p.h[k, COMMANDS + i] += weight * U[k, i] / F[i]
