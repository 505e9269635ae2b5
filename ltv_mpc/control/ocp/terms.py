"""Cost of a trajectory, and its quadratic model: the only place that knows the terms of the cost.

Half the sum over the knots k = 1 .. N, with g_k the length of the stage that ends at knot k, of

    position            w g_k |p_k - ref_k|^2                    w     position_per_m2 (1/m2)
    heading             q g_k (psi_k - psiref_k)^2               q     heading_per_rad2 (1/rad2), the short way round
    thrust              r g_k |U_k / F|^2                        r     thrust
    change of thrust    s / g_k |(U_k - U_(k-1)) / F|^2          s     thrust_change: the integral of the rate squared

and at the last knot

    terminal position   w_N |p_N - ref_N|^2                      w_N   terminal_position_per_m2 (1/m2)
    terminal velocity   m |p'_N - ref'_N|^2                      m     terminal_velocity_s2_per_m2 (s2/m2)

with F the larger side of each thruster's box (N) and p' the velocity over ground. The tolerance of a point moves ref_k
to the nearest point of a disc about it (``lateral.py``). The terminal velocity separates a vehicle that stops on its
point from one that passes or orbits it: within a short horizon both are equally near. Its model takes the slope of p'
in [u, v, psi] and leaves out the curvature (Gauss-Newton).

Arguments, here and in ``limits.py``:

    X       (N+1, 8) states n, e, u, v, psi, r, F1, F2 at the knots
    U       (N+1, 2) commands (N)
    C       (N+1, 2) current, north and east (m/s)
    target  (N+1, 3) positions (m) wanted at the knots 1 .. N, then the velocity over ground (m/s) wanted at the last
            one; third column: the heading (rad) wanted at the knots 1 .. N, read if the heading has a weight
    o       constants of the controller: weights, limits, scales and knots
    p       problem (problem.py), or None
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.control.linearisation import velocity_over_ground
from ltv_mpc.control.ocp.problem import Problem
from ltv_mpc.control.problem_data import (
    CHANGES,
    COMMANDS,
    HEADING,
    POSITION,
    TERMINAL_POSITION,
    TERMINAL_VELOCITY,
    THRUST,
    THRUST_CHANGE,
    Constants,
)
from ltv_mpc.jit import jit
from ltv_mpc.messages import Array


@jit
def cost(X: Array, U: Array, C: Array, target: Array, o: Constants, p: Problem | None) -> float:
    """Return the cost of a trajectory, and add gradient and Hessian of its terms to a problem.

    Parameters
    ----------
    X, U, C, target, o : as at the head of this file.
    p : None: the cost alone.
    """
    total, N, w, S, F = 0.0, len(X) - 1, o.weights, o.state_scale, o.thrust_scale
    for k in range(1, N + 1):
        g = o.t[k] - o.t[k - 1]
        for i in range(2):
            place = w[POSITION] * g + (w[TERMINAL_POSITION] if k == N else 0.0)
            total += _square(p, k, i, place, X[k, i] - target[k - 1, i], S[i])
            total += _square(p, k, COMMANDS + i, w[THRUST] * g, U[k, i] / F[i], 1.0)
            total += _square(p, k - 1, CHANGES + i, w[THRUST_CHANGE] / g, (U[k, i] - U[k - 1, i]) / F[i], 1.0)
        if w[HEADING] != 0.0:
            off = X[k, 4] - target[k - 1, 2]
            off -= 2.0 * np.pi * np.round(off / (2.0 * np.pi))
            total += _square(p, k, 4, w[HEADING] * g, off, S[4])
    velocity, slope = velocity_over_ground(X[N], C[N])
    for axis in range(2):
        off = velocity[axis] - target[N, axis]
        total += w[TERMINAL_VELOCITY] * off * off
        if p is not None:
            for i in range(3):
                weight = w[TERMINAL_VELOCITY] * slope[axis, i] * S[2 + i]
                p.h[N, 2 + i] += weight * off
                for j in range(3):
                    p.H[N, 2 + i, 2 + j] += weight * slope[axis, j] * S[2 + j]
    return 0.5 * total


@jit
def _square(p: Problem | None, k: int, i: int, weight: float, off: float, slope: float) -> float:
    """Return weight off^2, and add the model of its half, with the slope of ``off`` in number i of stage k."""
    if p is not None:
        p.H[k, i, i] += weight * slope * slope
        p.h[k, i] += weight * slope * off
    return weight * off * off
