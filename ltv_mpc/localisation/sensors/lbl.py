"""Long baseline: half a travel time, times the assumed sound speed, is a range to a transponder of known position.

z = c0 t / 2 = r / (1 + s) + n,  r = |d|,  d = p + q - P_j,  q = R l,  s = c / c0 - 1 (a state, or 0)
With u = d / r:  d z / d p = u / (1 + s),  d z / d phi = (q x u) / (1 + s),  d z / d s = -r / (1 + s)^2
Curved  At a drift of sd sigma across the line of sight the range is longer by about sigma^2 / 2r than its tangent says:
        4.5 m at 30 m and 100 m. A filter that leaves this out claims a knowledge that the circle does not give it, and
        its gate then turns good ranges away. So the second-order term of a Gaussian error is kept,
            z = z(belief) + H error + tr(D P) / 2 + n',  var n' = var n + C,  D = (I - u u^T) / (r (1 + s)),  P of p
        The term's variance is tr(D P D P) / 2, but it is a square: where a Gaussian error reaches 3 deviations it
        reaches 5.7 of its own. C takes twice its deviation, C = 2 tr(D P D P): at 30 m and 100 m 99 % of first fixes
        then lie within 3 sigma, with once 97 %, without it 67 %.
        The next range to the same transponder is wrong by the same term, not by another draw: it may make the distance
        no better known than C, so with A = H P H^T the variance is at least that which leaves C,  A C / (A - C).
        All of this vanishes as other ranges make the position known: 1.4 cm at 1 m and 100 m. Iterating instead would
        put the estimate on the circle but leave the covariance along its tangent, as certain as before.
Source  Jazwinski 1970, section 9.3 (Gaussian second-order filter).
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.localisation.filter.state import ATTITUDE, POSITION, Belief
from ltv_mpc.localisation.sensor_config import Lbl
from ltv_mpc.localisation.sensors import lever_arm
from ltv_mpc.localisation.sensors.rows import Rows
from ltv_mpc.messages import LblRange

_NEAREST_M = 0.1
"""Ranges are taken as no shorter: the direction to a transponder at the vehicle's own place is not defined."""

_KNOWN = 1.000001
"""A / C down to which a range still says something."""


def rows(belief: Belief, lbl_range: LblRange, lbl: Lbl) -> Rows:
    """One row. The caller has made sure that the transponder is one of ``lbl``'s. The covariance is that of now."""
    head = lever_arm.point(belief, lbl.lever_arm_m)
    d = belief.x[POSITION] + head.offset - np.array(lbl.transponders_m[lbl_range.transponder])
    r = max(float(np.sqrt(d @ d)), _NEAREST_M)
    u = d / r
    speed = belief.layout.sound_speed
    k = 1.0 / (1.0 + float(belief.x[speed].sum()))

    P = belief.P[POSITION, POSITION]
    DP = (k / r) * (np.eye(3) - np.outer(u, u)) @ P
    C, A = 2.0 * float(np.trace(DP @ DP)), k * k * float(u @ P @ u)
    floor = A * C / (A - C) if A > _KNOWN * C else C / (_KNOWN - 1.0)
    partial = np.zeros((1, 6 + speed.stop - speed.start))
    partial[0, :3] = k * u
    partial[0, 3:6] = k * u @ head.by_attitude
    partial[0, 6:] = -k * k * r
    attitude = range(ATTITUDE.start, ATTITUDE.stop)
    return Rows(
        state=np.array([[*range(POSITION.start, POSITION.stop), *attitude, *range(speed.start, speed.stop)]]),
        partial=partial,
        residual=np.array([0.5 * lbl.sound_speed_mps * lbl_range.travel_time_s - k * r - 0.5 * np.trace(DP)]),
        variance=np.array([max(lbl.range_sd_m**2 + C, floor)]),
    )
