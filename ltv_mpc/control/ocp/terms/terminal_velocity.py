"""Terminal velocity: difference from the wanted velocity over ground p' at the last knot.

    1/2 m |p'_N - ref'_N|^2,    m = terminal_velocity_s2_per_m2 (s2/m2)

It separates a vehicle that stops on its point from one that passes or orbits it: within a short horizon both are
equally near. Its model takes the slope of p' in [u, v, psi] and leaves out the curvature (Gauss-Newton).
"""

from __future__ import annotations

from ltv_mpc.control.linearisation import Linearisation, velocity_over_ground
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
    velocity, _ = velocity_over_ground(X[N], C[N])
    wn, we = velocity[0] - target[N, 0], velocity[1] - target[N, 1]
    return float(0.5 * o.terminal_velocity * (wn * wn + we * we))


@jit
def add(p: Problem, lin: Linearisation, target: Array, o: Objective) -> None:
    """Add the quadratic model.

    Parameters
    ----------
    p, lin, target, o : as in ``ocp/terms``.
    """
    N, S = len(lin.X) - 1, o.state_scale
    velocity, slope = velocity_over_ground(lin.X[N], lin.C[N])
    for axis in range(2):
        for i in range(3):
            weight = o.terminal_velocity * slope[axis, i] * S[2 + i]
            p.h[N, 2 + i] += weight * (velocity[axis] - target[N, axis])
            for j in range(3):
                p.H[N, 2 + i, 2 + j] += weight * slope[axis, j] * S[2 + j]
