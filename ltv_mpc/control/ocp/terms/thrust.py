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
def cost(k: int, X: Array, U: Array, C: Array, target: Array, o: Objective) -> float:
    """Return the value at a knot.

    Parameters
    ----------
    k, X, U, C, target, o : as in ``ocp/terms``.
    """
    port, starboard = U[k, 0] / o.thrust_scale[0], U[k, 1] / o.thrust_scale[1]
    return float(0.5 * o.thrust * stage_length(o, k) * (port * port + starboard * starboard))


@jit
def add(p: Problem, k: int, lin: Linearisation, target: Array, o: Objective) -> None:
    """Add the quadratic model at a knot.

    Parameters
    ----------
    p, k, lin, target, o : as in ``ocp/terms``.
    """
    weight = o.thrust * stage_length(o, k)
    for i in range(2):
        p.H[k, COMMANDS + i, COMMANDS + i] += weight
        p.h[k, COMMANDS + i] += weight * lin.U[k, i] / o.thrust_scale[i]
