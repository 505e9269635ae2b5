"""What lies beyond the horizon, as far as a choice between trajectories needs it: whether one of them ends stuck.

At full thrust stern-to and off its target, a vehicle that is weaker astern may not get any nearer. To turn costs more
within the horizon than to stay: it drifts meanwhile. So it would stay, for ever. At the end of a trajectory, with
d = |ref - p|, e = (ref - p) / d and b = ref' - c, the velocity through the water that keeps pace with the target,

    s = the largest with |e s + b| <= V          speed at which it can still close in; V - |b| where there is none
    V = top speed ahead, or astern where the stern points along e s + b
    stuck: d > NEAR_LENGTHS L and s < SLOW_RATIO of the top speed ahead

    beyond = w / h integral of (d - s t)^2 dt until it is there, over MAX_TAIL_TIMES T at most

L, T and V as in ``scaling.py``. That is added to the costs of two guesses where one of them ends stuck, and the line
search takes no step from where it is not to where it would be (``nominal_trajectory.py``). Else it counts for
nothing: it holds
for a steady current, and within the horizon the QP knows better.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ltv_mpc.control.problem_data import Constants
from ltv_mpc.control.scaling import PAPER_SCALES
from ltv_mpc.jit import jit
from ltv_mpc.messages import Array
from ltv_mpc.vehicle.resistance import steady_speed

NEAR_LENGTHS, SLOW_RATIO = 0.1, 0.1
MAX_TAIL_TIMES = 200.0
"""24 minutes of the paper's vehicle: who holds a place holds it for long, and a steered guess turns in a wider circle
than the plan that comes of it.
"""

TIME_S = PAPER_SCALES.time_s


class TerminalCheck(NamedTuple):
    """Of the end of one trajectory."""

    stuck: bool
    tail_cost: float  # cost


@jit
def closing_speed(en: float, ee: float, bn: float, be: float, V: float) -> float:
    """The largest s with |e s + b| <= V."""
    along, square = en * bn + ee * be, bn * bn + be * be
    root = along * along - square + V * V
    return -along + math.sqrt(root) if root >= 0.0 else V - math.sqrt(square)


@jit
def check_terminal(X: Array, C: Array, target: Array, c: Constants) -> TerminalCheck:
    """Of states X (N+1, 8) in a current C (N+1, 2); ``target`` (N+1, 2) as in ``Solver``."""
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
    return TerminalCheck(s < SLOW_RATIO * ahead, o.position / c.stage_s * t * (d * d - d * s * t + s * s * t * t / 3.0))
