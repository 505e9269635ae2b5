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
def cost(X: Array, U: Array, C: Array, target: Array, o: Objective) -> float:
    """Return the value along a trajectory.

    Parameters
    ----------
    X, U, C, target, o : as in ``ocp/terms``.
    """
    N = len(X) - 1
    dn, de = X[N, 0] - target[N - 1, 0], X[N, 1] - target[N - 1, 1]
    return float(0.5 * o.terminal_position * (dn * dn + de * de))


@jit
def add(p: Problem, lin: Linearisation, target: Array, o: Objective) -> None:
    """Add the quadratic model.

    Parameters
    ----------
    p, lin, target, o : as in ``ocp/terms``.
    """
    N, S = len(lin.X) - 1, o.state_scale
    for i in range(2):
        p.H[N, i, i] += o.terminal_position * S[i] * S[i]
        p.h[N, i] += o.terminal_position * S[i] * (lin.X[N, i] - target[N - 1, i])
