"""Terminal check: detect a trajectory that ends stuck, and estimate its cost beyond the horizon.

A vehicle that is weaker astern can be off its target with its stern towards it, at full thrust, and not get any nearer.
Within the horizon a turn costs more than staying, because the vehicle drifts while it turns. So it would stay for ever.
At the end of a trajectory, with d = |ref - p|, e = (ref - p) / d and b = ref' - c, the velocity through the water that
keeps pace with the target,

    s = the largest with |e s + b| <= V          closing speed towards the target; V - |b| if there is none
    V = top speed ahead, or astern where the stern points along e s + b
    stuck: d > NEAR_LENGTHS L and s < SLOW_RATIO of the top speed ahead

    tail cost = 1/2 w / h integral of (d - s t)^2 dt until the target is reached, over MAX_TAIL_TIMES T at most

L, T and V as in scaling.py. The tail cost is added to the costs of two trajectories where one of them ends stuck
(nominal.py), and the line search takes no step from a trajectory that is not stuck to one that is. Otherwise
the tail cost is ignored: it assumes a steady current, and within the horizon the QP is more accurate.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ltv_mpc.control.problem_data import Constants
from ltv_mpc.control.scaling import PAPER_SCALES
from ltv_mpc.jit import jit
from ltv_mpc.messages import Array
from ltv_mpc.vehicle.resistance import steady_speed

NEAR_LENGTHS = 0.1
"""Distance below which a vehicle is never stuck, over its length scale L."""

SLOW_RATIO = 0.1
"""Closing speed below which a vehicle is stuck, over its top speed ahead."""

MAX_TAIL_TIMES = 200.0
"""Longest time of the tail cost over the time scale T: 24 minutes for the paper's vehicle. A station is held for long,
and a steering guess turns in a wider circle than the plan that results from it.
"""

TIME_S = PAPER_SCALES.time_s


class TerminalCheck(NamedTuple):
    """Terminal check of one trajectory."""

    stuck: bool  # True if it cannot approach its target any more
    tail_cost: float  # cost beyond the horizon, in units of the cost


@jit
def closing_speed(en: float, ee: float, bn: float, be: float, V: float) -> float:
    """Return the closing speed: the largest s with |e s + b| <= V.

    Parameters
    ----------
    en, ee : unit vector towards the target, north and east.
    bn, be : velocity through the water that keeps pace with the target (m/s).
    V : top speed through the water (m/s).

    Returns
    -------
    s (m/s); V - |b| < 0 if the vehicle cannot keep on the line.
    """
    along, square = en * bn + ee * be, bn * bn + be * be
    root = along * along - square + V * V
    return -along + math.sqrt(root) if root >= 0.0 else V - math.sqrt(square)


@jit
def check_terminal(X: Array, C: Array, target: Array, c: Constants) -> TerminalCheck:
    """Check the end of a trajectory.

    Parameters
    ----------
    X : (N+1, 8) states at the knots; only the last is used.
    C : (N+1, 2) current at the knots, north and east (m/s).
    target : (N+1, 3) as in ``ocp/terms``.
    c : constants of the controller.

    Returns
    -------
    Whether it is stuck, and its tail cost.
    """
    N, o, p = len(target) - 1, c.objective, c.p
    dn, de = target[N - 1, 0] - X[N, 0], target[N - 1, 1] - X[N, 1]
    d = math.sqrt(dn * dn + de * de)
    T, ahead = TIME_S * c.time_ratio, steady_speed(o.high[0] + o.high[1], p.linear_surge, p.quadratic_surge)
    if d <= NEAR_LENGTHS * ahead * T:
        return TerminalCheck(False, 0.0)
    en, ee = dn / d, de / d
    bn, be = target[N, 0] - C[N, 0], target[N, 1] - C[N, 1]
    s = closing_speed(en, ee, bn, be, ahead)
    if math.cos(X[N, 4]) * (en * s + bn) + math.sin(X[N, 4]) * (ee * s + be) < 0.0:
        astern = steady_speed(max(-o.low[0] - o.low[1], 0.0), p.linear_surge, p.quadratic_surge)
        s = closing_speed(en, ee, bn, be, astern)
    t = MAX_TAIL_TIMES * T
    if s * t > d:
        t = d / s
    return TerminalCheck(
        s < SLOW_RATIO * ahead, 0.5 * o.position / c.stage_s * t * (d * d - d * s * t + s * s * t * t / 3.0)
    )
