"""Cost of a trajectory along the exact flow, in the terms of the QP's cost (qp/sparse.py).

    J = sum over k = 1..N of  g_k (w |p_k - ref_k|^2 + r |U_k / F|^2) + s / g_k |(U_k - U_(k-1)) / F|^2 + c g_k e_k / S
        + g_k w_psi (psi_k - psiref_k)^2 + w_N |p_N - ref_N|^2 + m |p'_N - ref'_N|^2

The quadratic terms lack the factor 1/2 of the QP. The cost of an excess e is that of the QP, so it weighs half as much
here in comparison.

Every term is at least zero, so an incomplete sum is a lower bound: a search for the cheapest of several trajectories
can abandon one as soon as it costs more than another.
"""

from __future__ import annotations

from ltv_mpc.control.horizon_limits import LIMITED_STATES
from ltv_mpc.control.linearisation import velocity_over_ground
from ltv_mpc.control.problem_data import Objective, excess_penalty, heading_slope, stage_length
from ltv_mpc.jit import jit
from ltv_mpc.messages import Array


@jit
def cost(X: Array, U: Array, C: Array, target: Array, o: Objective) -> float:
    """Return the cost J of a trajectory.

    Parameters
    ----------
    X : (N+1, 8) states at the knots.
    U : (N+1, 2) commands at the knots (N).
    C : (N+1, 2) current at the knots, north and east (m/s).
    target : (N+1, 3) as in ``Solver.build``.
    o : weights, limits and knots.

    Returns
    -------
    J, without unit.
    """
    total, penalty = 0.0, excess_penalty(X, target, o)
    for k in range(1, U.shape[0]):
        total += stage_cost(X, U, target, k, o, penalty)
    return total + terminal_cost(X, C, target, o)


@jit
def stage_cost(X: Array, U: Array, target: Array, k: int, o: Objective, penalty: float) -> float:
    """Return the part of J that knot k = 1 .. N adds.

    Parameters
    ----------
    X, U, target, o : as in ``cost``.
    k : knot.
    penalty : ``excess_penalty``.

    Returns
    -------
    Cost of position, heading, thrust, change of thrust and soft limits.
    """
    g = stage_length(o, k)
    dn, de = X[k, 0] - target[k - 1, 0], X[k, 1] - target[k - 1, 1]
    total = o.position * g * (dn * dn + de * de)
    if o.heading != 0.0:
        slope = heading_slope(X, target, k, o)
        total += slope * slope / (o.heading * g)
    for i in range(2):
        here, before = U[k, i] / o.thrust_scale[i], U[k - 1, i] / o.thrust_scale[i]
        total += o.thrust * g * here * here + o.thrust_change / g * (here - before) * (here - before)
        state = X[k, LIMITED_STATES[i]]
        excess = max(o.low_state[i] - state, state - o.high_state[i])
        if excess > 0.0:
            total += penalty * g * excess / o.state_scale[LIMITED_STATES[i]]
    return float(total)


@jit
def terminal_cost(X: Array, C: Array, target: Array, o: Objective) -> float:
    """Return the part of J that only the last knot adds.

    Parameters
    ----------
    X, C, target, o : as in ``cost``.

    Returns
    -------
    Terminal cost of position and velocity over ground.
    """
    N = X.shape[0] - 1
    dn, de = X[N, 0] - target[N - 1, 0], X[N, 1] - target[N - 1, 1]
    velocity, _ = velocity_over_ground(X[N], C[N])
    wn, we = velocity[0] - target[N, 0], velocity[1] - target[N, 1]
    return float(o.terminal_position * (dn * dn + de * de) + o.terminal_velocity * (wn * wn + we * we))
