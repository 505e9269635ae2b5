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
def cost(X: Array, U: Array, C: Array, target: Array, o: Objective) -> float:
    """Return the value along a trajectory.

    Parameters
    ----------
    X, U, C, target, o : as in ``ocp/terms``.
    """
    total, F, t = 0.0, o.thrust_scale, o.t
    for k in range(1, len(U)):
        port, starboard = (U[k, 0] - U[k - 1, 0]) / F[0], (U[k, 1] - U[k - 1, 1]) / F[1]
        total += (port * port + starboard * starboard) / stage_length(t, k)
    return float(0.5 * o.thrust_change * total)


@jit
def add(p: Problem, lin: Linearisation, target: Array, o: Objective) -> None:
    """Add the quadratic model, in the input of the stage before each knot.

    Parameters
    ----------
    p, lin, target, o : as in ``ocp/terms``.
    """
    U, F, t = lin.U, o.thrust_scale, o.t
    for k in range(1, len(U)):
        weight = o.thrust_change / stage_length(t, k)
        for i in range(2):
            p.H[k - 1, CHANGES + i, CHANGES + i] += weight
            p.h[k - 1, CHANGES + i] += weight * (U[k, i] - U[k - 1, i]) / F[i]
