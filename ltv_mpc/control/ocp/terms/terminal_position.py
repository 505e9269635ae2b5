"""Terminal position: distance from the target at the last knot, in addition to that of each knot.

1/2 w_N |p_N - ref_N|^2,    w_N = terminal_position_per_m2 (1/m2)
"""

from __future__ import annotations

from ltv_mpc.control.linearisation import Linearisation
from ltv_mpc.control.ocp.problem import Problem
from ltv_mpc.control.problem_data import Objective
from ltv_mpc.jit import jit
from ltv_mpc.messages import Array


@jit
def cost(k: int, X: Array, U: Array, C: Array, target: Array, o: Objective) -> float:
    """Return the value at a knot.

    Parameters
    ----------
    k, X, U, C, target, o : as in ``ocp/terms``.
    """
    if k < len(X) - 1:
        return 0.0
    dn, de = X[k, 0] - target[k - 1, 0], X[k, 1] - target[k - 1, 1]
    return float(0.5 * o.terminal_position * (dn * dn + de * de))


@jit
def add(p: Problem, k: int, lin: Linearisation, target: Array, o: Objective) -> None:
    """Add the quadratic model at a knot.

    Parameters
    ----------
    p, k, lin, target, o : as in ``ocp/terms``.
    """
    if k == len(lin.X) - 1:
        for i in range(2):
            p.H[k, i, i] += o.terminal_position * o.state_scale[i] * o.state_scale[i]
            p.h[k, i] += o.terminal_position * o.state_scale[i] * (lin.X[k, i] - target[k - 1, i])
