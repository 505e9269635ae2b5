"""Change of thrust: difference of the commands from those of the knot before.

    1/2 s / g_k |(U_k - U_(k-1)) / F|^2,    s = thrust_change, F the larger side of each thruster's box (N)

The sum over stages approximates an integral of the slew rate squared, so the weight goes with 1 / g_k.
"""

from __future__ import annotations

from ltv_mpc.control.linearisation import Linearisation
from ltv_mpc.control.ocp.problem import Problem
from ltv_mpc.control.problem_data import CHANGES, Objective, stage_length
from ltv_mpc.jit import jit
from ltv_mpc.messages import Array


@jit
def cost(k: int, X: Array, U: Array, C: Array, target: Array, o: Objective) -> float:
    """Return the value at a knot.

    Parameters
    ----------
    k, X, U, C, target, o : as in ``ocp/terms``.
    """
    port = (U[k, 0] - U[k - 1, 0]) / o.thrust_scale[0]
    starboard = (U[k, 1] - U[k - 1, 1]) / o.thrust_scale[1]
    return float(0.5 * o.thrust_change / stage_length(o, k) * (port * port + starboard * starboard))


@jit
def add(p: Problem, k: int, lin: Linearisation, target: Array, o: Objective) -> None:
    """Add the quadratic model at a knot, in the input of the stage before it.

    Parameters
    ----------
    p, k, lin, target, o : as in ``ocp/terms``.
    """
    weight = o.thrust_change / stage_length(o, k)
    for i in range(2):
        p.H[k - 1, CHANGES + i, CHANGES + i] += weight
        p.h[k - 1, CHANGES + i] += weight * (lin.U[k, i] - lin.U[k - 1, i]) / o.thrust_scale[i]
