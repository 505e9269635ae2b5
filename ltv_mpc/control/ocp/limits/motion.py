"""Motion: lower and upper limits of surge through the water and of the yaw rate, soft.

    low <= x_k <= high,    an excess e costs  c g_k e / S

The past can make a limit impossible to keep, so it is soft. The dual of a limit of speed is the gain from passing it:
at most the slope of the cost of position, summed over the horizon, times the way that the excess makes. Duals that
occur are up to 0.4 times that sum, which is the penalty c (``excess_penalty``). It grows with the distance of the
target.
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.control.horizon_limits import LIMITED_STATES, MIN_PENALTY
from ltv_mpc.control.linearisation import Linearisation
from ltv_mpc.control.ocp.problem import Problem
from ltv_mpc.control.problem_data import Objective, stage_length
from ltv_mpc.jit import jit
from ltv_mpc.messages import Array

ROW = 4


@jit
def cost(X: Array, target: Array, o: Objective) -> float:
    """Return the cost of the excesses along a trajectory, which is that of the problem.

    Parameters
    ----------
    X, target, o : as in ``ocp/terms``.
    """
    total, t = 0.0, o.t
    for j in range(2):
        if is_limited(o, j):
            i = LIMITED_STATES[j]
            low, high = o.low_state[j], o.high_state[j]
            for k in range(1, len(X)):
                total += stage_length(t, k) * max(low - X[k, i], X[k, i] - high, 0.0) / o.state_scale[i]
    return float(excess_penalty(X, target, o) * total) if total > 0.0 else 0.0


@jit
def add(p: Problem, lin: Linearisation, target: Array, o: Objective) -> None:
    """Add the rows.

    Parameters
    ----------
    p, lin, target, o : as in ``ocp/terms``.
    """
    X, t, penalty = lin.X, o.t, excess_penalty(lin.X, target, o)
    for j in range(2):
        if is_limited(o, j):
            i = LIMITED_STATES[j]
            S = o.state_scale[i]
            for k in range(1, len(X)):
                p.G[k, ROW + j, i] = 1.0
                p.low[k, ROW + j], p.high[k, ROW + j] = (o.low_state[j] - X[k, i]) / S, (o.high_state[j] - X[k, i]) / S
                p.penalty[k, ROW + j] = penalty * stage_length(t, k)


@jit
def excess_penalty(X: Array, target: Array, o: Objective) -> float:
    """Return the cost of an excess that is 1 in the problem, over one first stage: more than the duals that occur.

    Parameters
    ----------
    X : (N+1, 8) states at the knots; the first one counts.
    target, o : as in ``ocp/terms``.

    Returns
    -------
    S sum over k of w_k |p_0 - ref_k|, at least ``MIN_PENALTY``; that where no state is limited.
    """
    if not (is_limited(o, 0) or is_limited(o, 1)):
        return MIN_PENALTY
    N, pull = target.shape[0] - 1, 0.0
    for k in range(N):
        weight = o.position * stage_length(o.t, k + 1) + (o.terminal_position if k == N - 1 else 0.0)
        pull += weight * np.hypot(X[0, 0] - target[k, 0], X[0, 1] - target[k, 1])
    return float(max(MIN_PENALTY, pull * o.state_scale[0]))


@jit
def is_limited(o: Objective, j: int) -> bool:
    """Return True if the state ``horizon_limits.LIMITED_STATES[j]`` has a lower or an upper limit.

    Parameters
    ----------
    o : has the limits.
    j : 0 or 1.
    """
    return bool(np.isfinite(o.low_state[j]) or np.isfinite(o.high_state[j]))
