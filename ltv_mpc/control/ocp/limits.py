"""Limits that have rows at every knot, and what it costs to exceed them; those of zones and paths are in ``fence.py``.

    box      low <= U_k <= high                    hard; the line search keeps it exactly, by clipping
    slew     |U_k - U_(k-1)| <= slew h_k           hard; likewise
    motion   low <= x_k <= high                    soft: an excess e of surge or yaw rate costs  c g_k e / S

A start outside the box (a limit that was just lowered) returns into it at the slew limit (``command_bounds``). Commands
are linear between knots, so |dF/dt| <= slew everywhere, and also at the junction of two plans, because U_0 is the
command in force there.

The slew limit is never violated. The box is violated only while a command that starts outside it returns.

The past can make a limit of the motion impossible to keep, so it is soft, with an exact penalty (``problem.py``): once
that is larger than the dual of the limit, the solution is that of the hard limit wherever there is one. The dual of a
limit of speed is the gain from passing it: at most the slope of the cost of position, summed over the horizon, times
the way that the excess makes. Duals that occur are up to 0.4 times that sum, which is the penalty (``excess_penalty``).

Arguments as in ``terms.py``; ``lin`` is the motion along the nominal trajectory.
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.control.linearisation import Linearisation
from ltv_mpc.control.ocp.problem import Problem
from ltv_mpc.control.problem_data import (
    CHANGES,
    COMMANDS,
    LIMITED_STATES,
    POSITION,
    TERMINAL_POSITION,
    Constants,
)
from ltv_mpc.jit import jit
from ltv_mpc.messages import Array

BOX, SLEW, MOTION, ROWS = 0, 2, 4, 6
"""First row at a knot: box of port and starboard, slew of both, surge and yaw rate; and the number of all rows."""

MIN_PENALTY = 100.0
"""Least cost of an excess that is 1 in the QP, over one stage of 0.3 s."""


@jit
def cost(X: Array, target: Array, o: Constants) -> float:
    """Return the cost of the excesses along a trajectory, which is that of the problem.

    Parameters
    ----------
    X, target, o : as in ``terms.py``.
    """
    total = 0.0
    for j in range(2):
        i = LIMITED_STATES[j]
        for k in range(1, len(X)):
            excess = max(o.low_state[j] - X[k, i], X[k, i] - o.high_state[j], 0.0)
            total += (o.t[k] - o.t[k - 1]) * excess / o.state_scale[i]
    return float(excess_penalty(X, target, o) * total) if total > 0.0 else 0.0


@jit
def add(p: Problem, lin: Linearisation, target: Array, o: Constants) -> None:
    """Add the rows to a problem.

    Parameters
    ----------
    p : problem.
    lin, target, o : as at the head of this file.
    """
    X, U, F, penalty = lin.X, lin.U, o.thrust_scale, excess_penalty(lin.X, target, o)
    for k in range(1, len(U)):
        g = o.t[k] - o.t[k - 1]
        for i in range(2):
            low, high = command_bounds(U[0, i], o.t[k] * o.max_change[i], o.low[i], o.high[i])
            p.G[k, BOX + i, COMMANDS + i] = 1.0
            p.low[k, BOX + i], p.high[k, BOX + i] = (low - U[k, i]) / F[i], (high - U[k, i]) / F[i]
            most, change = g * o.max_change[i], U[k, i] - U[k - 1, i]
            p.G[k - 1, SLEW + i, CHANGES + i] = 1.0
            p.low[k - 1, SLEW + i], p.high[k - 1, SLEW + i] = (-most - change) / F[i], (most - change) / F[i]
            j, row = LIMITED_STATES[i], MOTION + i
            if np.isfinite(o.low_state[i]) or np.isfinite(o.high_state[i]):
                S = o.state_scale[j]
                p.G[k, row, j], p.penalty[k, row] = 1.0, penalty * g
                p.low[k, row], p.high[k, row] = (o.low_state[i] - X[k, j]) / S, (o.high_state[i] - X[k, j]) / S


@jit
def excess_penalty(X: Array, target: Array, o: Constants) -> float:
    """Return the cost of an excess that is 1 in the problem, over one first stage: more than the duals that occur.

    Parameters
    ----------
    X : (N+1, 8) states at the knots; the first one counts.
    target, o : as in ``terms.py``.

    Returns
    -------
    S sum over k of w_k |p_0 - ref_k|, at least ``MIN_PENALTY``.
    """
    N, pull = target.shape[0] - 1, 0.0
    for k in range(N):
        weight = o.weights[POSITION] * (o.t[k + 1] - o.t[k]) + (o.weights[TERMINAL_POSITION] if k == N - 1 else 0.0)
        pull += weight * np.hypot(X[0, 0] - target[k, 0], X[0, 1] - target[k, 1])
    return float(max(MIN_PENALTY, pull * o.state_scale[0]))


def names(scale: Array) -> list[tuple[str, float, str]]:
    """Return name, scale and unit of the rows at a knot: a row times its scale has the unit.

    Parameters
    ----------
    scale : (12,) what is 1 in states and inputs (assembly.py).

    Returns
    -------
    In a name ``{stage}`` stands for the stage that begins at the knot, ``{knot}`` for the knot.
    """
    sides = ("port", float(scale[COMMANDS])), ("starboard", float(scale[COMMANDS + 1]))
    return [
        *((f"limit of {side} at the end of stage {{knot}}", F, "N") for side, F in sides),
        *((f"slew of {side} in stage {{stage}}", F, "N") for side, F in sides),
        ("limit of surge at the end of stage {knot}", float(scale[2]), "m/s"),
        ("limit of yaw rate at the end of stage {knot}", float(scale[5]), "rad/s"),
    ]


@jit
def command_bounds(start: float, reach: float, low: float, high: float) -> tuple[float, float]:
    """Return the bounds of one thruster's command at a knot.

    A start outside the box (a limit that was just lowered) returns into it at the slew limit, so that the QP always has
    a solution. From a start inside, the bounds are the box itself, however little of it is within reach: the slew rows
    bound the commands already, and a box that is active nowhere costs the solver nothing.

    Parameters
    ----------
    start : command in force at knot 0 (N).
    reach : largest change from there to the knot (N).
    low, high : box (N).

    Returns
    -------
    Lower and upper bound (N).
    """
    return min(low, start + reach), max(high, start - reach)


@jit
def clip_to_limits(U: Array, t: Array, low: Array, high: Array, max_change: Array) -> None:
    """Clip commands in place, knot by knot: first to the slew from the knot before, then to the box.

    Parameters
    ----------
    U : (N+1, 2) commands (N); the first stays, the others are overwritten.
    t : (N+1,) knots in first stages.
    low, high : (2,) box (N).
    max_change : (2,) largest change over the first stage (N).
    """
    for k in range(1, U.shape[0]):
        for i in range(2):
            change = (t[k] - t[k - 1]) * max_change[i]
            lower, upper = command_bounds(U[0, i], t[k] * max_change[i], low[i], high[i])
            U[k, i] = min(max(U[k, i], U[k - 1, i] - change), U[k - 1, i] + change)
            U[k, i] = min(max(U[k, i], lower), upper)
