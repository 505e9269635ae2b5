"""Ultra-short baseline: position over ground, north and east, of the beacon at lever arm l, measured from a ship.

z = p + q + n, q = R l;  n ~ N(0, sd_p^2 + (sd_bearing r)^2) north and east, r the slant range from the ship, which is
at the surface where the sensors file has it, to where the beacon is believed to be. Partials in ``lever_arm.py``.
"""

from __future__ import annotations

import math

import numpy as np

from ltv_mpc.localisation.filter.state import ATTITUDE, POSITION, Belief
from ltv_mpc.localisation.sensor_config import Usbl
from ltv_mpc.localisation.sensors import lever_arm
from ltv_mpc.localisation.sensors.rows import Rows
from ltv_mpc.messages import UsblFix

_STATES = np.array([[own, *range(ATTITUDE.start, ATTITUDE.stop)] for own in (0, 1)])


def rows(belief: Belief, fix: UsblFix, usbl: Usbl) -> Rows:
    """Two rows."""
    beacon = lever_arm.point(belief, usbl.lever_arm_m)
    north, east, down = (belief.x[POSITION] + beacon.offset).tolist()
    slant = math.hypot(north - usbl.ship_m[0], east - usbl.ship_m[1], down)
    partial = np.zeros((2, 4))
    partial[:, 0] = 1.0
    partial[:, 1:] = beacon.by_attitude[:2]
    return Rows(
        state=_STATES,
        partial=partial,
        residual=np.array([fix.north_m - north, fix.east_m - east]),
        variance=np.full(2, usbl.position_sd_m**2 + (usbl.bearing_sd_rad * slant) ** 2),
    )
