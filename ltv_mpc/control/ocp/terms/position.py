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
def cost(X: Array, U: Array, C: Array, target: Array, o: Objective) -> float:
    """Return the value along a trajectory.

    Parameters
    ----------
    X, U, C, target, o : as in ``ocp/terms``.
    """
    total, t = 0.0, o.t
    for k in range(1, len(X)):
        dn, de = X[k, 0] - target[k - 1, 0], X[k, 1] - target[k - 1, 1]
        total += stage_length(t, k) * (dn * dn + de * de)
    return float(0.5 * o.position * total)


@jit
def add(p: Problem, lin: Linearisation, target: Array, o: Objective) -> None:
    """Add the quadratic model.

    Parameters
    ----------
    p, lin, target, o : as in ``ocp/terms``.
    """
    X, S, t = lin.X, o.state_scale, o.t
    for k in range(1, len(X)):
        for i in range(2):
            weight = o.position * stage_length(t, k) * S[i]
            p.H[k, i, i] += weight * S[i]
            p.h[k, i] += weight * (X[k, i] - target[k - 1, i])
