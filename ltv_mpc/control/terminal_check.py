"""Terminal check: detect a trajectory that ends stuck, and estimate its cost beyond the horizon.

A vehicle that is weaker astern can be off its target with its stern towards it, at full thrust, and not get any nearer.
Within the horizon a turn costs more than staying, because the vehicle drifts while it turns. So it would stay for ever.
At the end of a trajectory, with d = |ref - p|, e = (ref - p) / d and b = ref' - c, the velocity through the water that
keeps pace with the target,

    s = the largest with |e s + b| <= V          closing speed towards the target; V - |b| if there is none
    V = top speed ahead, or astern where the stern points along e s + b
    stuck: d > NEAR_LENGTHS L, and s < SLOW_RATIO of the top speed ahead, or d / s > TURN_TIMES T + d / s of the bow

    tail cost = 1/2 w / h integral of (d - s t)^2 dt until the target is reached, over MAX_TAIL_TIMES T at most

L, T and V as in scaling.py. The tail cost is added to the costs of two trajectories where one of them ends stuck
(nominal.py), and the line search takes no step from a trajectory that is not stuck to one that is. Otherwise
the tail cost is ignored: it assumes a steady current, and within the horizon the QP is more accurate.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ltv_mpc.control.problem_data import POSITION, STAGE_S, Constants
from ltv_mpc.control.scaling import PAPER_SCALES
from ltv_mpc.jit import jit
from ltv_mpc.messages import Array
from ltv_mpc.vehicle.dynamics import coefficients
from ltv_mpc.vehicle.resistance import steady_speed

NEAR_LENGTHS = 0.1
"""Distance below which a vehicle is never stuck, over its length scale L."""

SLOW_RATIO = 0.1
"""Closing speed below which a vehicle is stuck, over its top speed ahead."""

TURN_TIMES = 2.0
"""Time that a turn is worth, over the time scale T. A vehicle that would arrive later than by a turn is stuck, too."""

STEERED = 0.87
"""Speed over the top speed that a vehicle which is weak astern has left while it keeps its course across a current."""

BEGIN = 4
"""Knot at which a trajectory that goes astern is checked, too: a plan that turns at its end would put the turn off."""

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
def check_terminal(X: Array, C: Array, target: Array, o: Constants) -> TerminalCheck:
    """Check a trajectory: its end, and how it begins.

    Parameters
    ----------
    X : (N+1, 8) states at the knots.
    C : (N+1, 2) current at the knots, north and east (m/s).
    target : (N+1, 3) as in ``ocp/terms.py``.
    o : constants of the controller.

    Returns
    -------
    Whether it is stuck, and its tail cost.
    """
    N, T = len(target) - 1, TIME_S * o.time_ratio
    # on a path the course is given, and with it which end goes first
    stands = bool(target[N, 0] == 0.0 and target[N, 1] == 0.0)
    ends_stuck, d, s = _closing(X[N], C[N], target[N - 1], target[N], stands, o)
    if d == 0.0:
        return TerminalCheck(False, 0.0)
    k = min(BEGIN, N - 1)
    begins_stuck = stands and X[k, 6] + X[k, 7] < 0.0 and _closing(X[k], C[k], target[k], target[N], stands, o)[0]
    t = MAX_TAIL_TIMES * T
    if s * t > d:
        t = d / s
    tail_cost = 0.5 * o.weights[POSITION] / STAGE_S * t * (d * d - d * s * t + s * s * t * t / 3.0)
    return TerminalCheck(ends_stuck or begins_stuck, tail_cost)


@jit
def _closing(
    state: Array, current: Array, place: Array, pace: Array, stands: bool, o: Constants
) -> tuple[bool, float, float]:
    """Return whether a state is stuck, its distance (m), 0 if it is near, and its closing speed (m/s).

    ``stands``: the target does not move.
    """
    p, T = coefficients(o.p), TIME_S * o.time_ratio
    dn, de = place[0] - state[0], place[1] - state[1]
    d = math.sqrt(dn * dn + de * de)
    ahead = steady_speed(o.high[0] + o.high[1], p.linear_surge, p.quadratic_surge)
    if d <= NEAR_LENGTHS * ahead * T:
        return False, 0.0, ahead
    en, ee = dn / d, de / d
    bn, be = pace[0] - current[0], pace[1] - current[1]
    s = closing_speed(en, ee, bn, be, ahead)
    if math.cos(state[4]) * (en * s + bn) + math.sin(state[4]) * (ee * s + be) >= 0.0:
        return s < SLOW_RATIO * ahead, d, s
    astern, bow_first = steady_speed(max(-o.low[0] - o.low[1], 0.0), p.linear_surge, p.quadratic_surge), s
    s = closing_speed(en, ee, bn, be, STEERED * astern if astern < ahead and stands else astern)
    late = stands and d * (bow_first - s) > TURN_TIMES * T * s * bow_first
    return s < SLOW_RATIO * ahead or late, d, s
