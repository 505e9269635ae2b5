"""Position and velocity of a point of the vehicle that is not its origin, and their partial derivatives.

q = R l,  s = R (w x l) with w = w_m - b_g        l from the vehicle's origin (body), q and s in NED
point    p + q,  error dp + phi x q = dp - q^ phi
velocity v + s,  error dv - s^ phi + R l^ db_g     (dw = -db_g;  -(db_g x l) = l x db_g)
Neglected: the Earth's rate in w (0.07 mm/s per metre of lever) and the white noise of w_m (0.4 mm/s).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ltv_mpc.frames import skew
from ltv_mpc.localisation.filter.state import GYRO_BIAS, Belief
from ltv_mpc.messages import Array, Triple


class Point(NamedTuple):
    """Offset from the origin (m, NED), (3,), and its partial derivatives by attitude, (3, 3)."""

    offset: Array
    by_attitude: Array


class Swing(NamedTuple):
    """Velocity relative to the origin (m/s, NED), (3,), and its partials by attitude and gyro bias, (3, 3) each."""

    velocity: Array
    by_attitude: Array
    by_gyro_bias: Array


def point(belief: Belief, lever_m: Triple) -> Point:
    """Return the offset q of the end of a lever arm.

    Parameters
    ----------
    belief : the filter's belief, for its attitude.
    lever_m : lever arm l (m, body).
    """
    q = belief.R @ np.array(lever_m)
    return Point(q, -skew(q))


def swing(belief: Belief, lever_m: Triple, rate: Triple) -> Swing:
    """Return the velocity s of the end of a lever arm relative to the origin.

    Parameters
    ----------
    belief : the filter's belief, for its attitude and its gyro bias.
    lever_m : lever arm l (m, body).
    rate : angular rate w_m that the inertial unit measured, bias included (rad/s, body).
    """
    l = np.array(lever_m)  # noqa: E741  (the lever arm's symbol)
    s = belief.R @ np.cross(np.array(rate) - belief.x[GYRO_BIAS], l)
    return Swing(s, -skew(s), belief.R @ skew(l))
