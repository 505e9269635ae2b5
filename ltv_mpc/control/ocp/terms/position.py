"""Position: distance from the target at each knot.

    1/2 w g_k |p_k - ref_k|^2,    w = position_per_m2 (1/m2), g_k the length of the stage that ends at knot k

The tolerance of a point moves ref_k to the nearest point of a disc about it (``lateral.py``).
"""

from __future__ import annotations

from ltv_mpc.control.linearisation import Linearisation
from ltv_mpc.control.ocp.problem import Problem
from ltv_mpc.control.problem_data import Objective, stage_length
from ltv_mpc.jit import jit
from ltv_mpc.messages import Array


@jit
def cost(k: int, X: Array, U: Array, C: Array, target: Array, o: Objective) -> float:
    """Return the value at a knot.

    Parameters
    ----------
    k, X, U, C, target, o : as in ``ocp/terms``.
    """
    dn, de = X[k, 0] - target[k - 1, 0], X[k, 1] - target[k - 1, 1]
    return float(0.5 * o.position * stage_length(o, k) * (dn * dn + de * de))


@jit
def add(p: Problem, k: int, lin: Linearisation, target: Array, o: Objective) -> None:
    """Add the quadratic model at a knot.

    Parameters
    ----------
    p, k, lin, target, o : as in ``ocp/terms``.
    """
    for i in range(2):
        weight = o.position * stage_length(o, k) * o.state_scale[i]
        p.H[k, i, i] += weight * o.state_scale[i]
        p.h[k, i] += weight * (lin.X[k, i] - target[k - 1, i])
