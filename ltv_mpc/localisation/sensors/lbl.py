"""Long baseline: half a travel time, times the assumed sound speed, is a range to a transponder of known position.

z = c0 t / 2 = r / (1 + s) + n,  r = |d|,  d = p + q - P_j,  q = R l,  s = c / c0 - 1 (a state, or 0)
With u = d / r:  d z / d p = u / (1 + s),  d z / d phi = (q x u) / (1 + s),  d z / d s = -r / (1 + s)^2
Curvature
        At a position error of standard deviation sigma across the line of sight, the range is longer by about
        sigma^2 / 2r than its tangent: 4.5 m at 30 m and 100 m. A filter that leaves this out becomes too certain, and
        its gate then rejects good ranges. So the second-order term of a Gaussian error is kept,
            z = z(belief) + H error + tr(D P) / 2 + n',  var n' = var n + C,  D = (I - u u^T) / (r (1 + s)),  P of p
        The variance of the term is tr(D P D P) / 2, but the term is a square: where a Gaussian error reaches 3
        deviations, the square reaches 5.7 of its own. C takes twice its deviation, C = 2 tr(D P D P). At 30 m and 100 m
        99 % of first fixes then lie within 3 sigma; with one deviation 97 %, without C 67 %.
        The next range to the same transponder has the same error, not an independent one: it must not make the distance
        better known than C. So with A = H P H^T the variance is at least that which leaves C,  A C / (A - C).
        All of this vanishes as other ranges determine the position: 1.4 cm at 1 m and 100 m. An iterated update would
        put the estimate on the circle, but would leave the covariance along its tangent as certain as before.
Source  Jazwinski 1970, section 9.3 (Gaussian second-order filter).
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from msgspec import Meta

from ltv_mpc.localisation.filter.state import ATTITUDE, POSITION, Belief
from ltv_mpc.localisation.sensors import lever_arm
from ltv_mpc.localisation.sensors.sensor import Availability, Context, Linearised, Rows, Sensor, unusable
from ltv_mpc.localisation.sensors.settings import Lever, Position, PositiveSd, Sd, SensorSettings, Share
from ltv_mpc.messages import LblRange

_MIN_RANGE_M = 0.1
"""Shorter ranges are taken as this long: at the transponder's own position the direction to it is not defined."""

_MIN_VARIANCE_RATIO = 1.000001
"""A / C down to which a range still has an effect."""


class Lbl(SensorSettings, frozen=True, kw_only=True):
    """Long baseline: two-way ranges to transponders on the sea bed, all of them interrogated at once."""

    transponders_m: Annotated[tuple[Position, ...], Meta(min_length=1, max_length=16)]  # north, east, depth
    sound_speed_mps: Annotated[float, Meta(ge=1300, le=1700)]  # assumed for the ranges
    sound_speed_sd_mps: Annotated[float, Meta(ge=0, le=50)]  # of the true speed about it, constant
    range_sd_m: PositiveSd
    missing_share: Share
    outlier_share: Share
    outlier_m: Sd  # a path by way of surface or bottom is longer by up to this
    lever_arm_m: Lever = (0.0, 0.0, 0.0)


def linearise(belief: Belief, lbl_range: LblRange, lbl: Lbl, _: Context) -> Linearised:
    """Linearise a range about the belief, to second order.

    Parameters
    ----------
    belief : the filter's belief at the range's time, with its covariance at that time.
    lbl_range : travel time there and back (s).
    lbl : settings: positions of the transponders, and the assumed sound speed.

    Returns
    -------
    One row; none of a transponder that ``lbl`` does not know.
    """
    if lbl_range.transponder >= len(lbl.transponders_m):
        return unusable("unknown_transponder", 1)
    head = lever_arm.point(belief, lbl.lever_arm_m)
    d = belief.x[POSITION] + head.offset - np.array(lbl.transponders_m[lbl_range.transponder])
    r = max(float(np.sqrt(d @ d)), _MIN_RANGE_M)
    u = d / r
    speed = belief.layout.sound_speed
    k = 1.0 / (1.0 + float(belief.x[speed].sum()))

    P = belief.P[POSITION, POSITION]
    DP = (k / r) * (np.eye(3) - np.outer(u, u)) @ P
    C, A = 2.0 * float(np.trace(DP @ DP)), k * k * float(u @ P @ u)
    floor = A * C / (A - C) if A > _MIN_VARIANCE_RATIO * C else C / (_MIN_VARIANCE_RATIO - 1.0)
    partial = np.zeros((1, 6 + speed.stop - speed.start))
    partial[0, :3] = k * u
    partial[0, 3:6] = k * u @ head.by_attitude
    partial[0, 6:] = -k * k * r
    rows = Rows(
        state=np.r_[POSITION, ATTITUDE, speed][None],
        partial=partial,
        residual=np.array([0.5 * lbl.sound_speed_mps * lbl_range.travel_time_s - k * r - 0.5 * np.trace(DP)]),
        variance=np.array([max(lbl.range_sd_m**2 + C, floor)]),
    )
    return Linearised(rows=rows, indices=np.array([lbl_range.transponder]))


LBL = Sensor(
    name="lbl",
    message=LblRange,
    settings=Lbl,
    scalars_per_message=1,
    at_rest=lambda t_ns, _: LblRange(t_ns=t_ns, transponder=0, travel_time_s=1.0),
    linearise=linearise,
    availability=Availability.INTERMITTENT,
    source=lambda lbl_range: lbl_range.transponder,
)
