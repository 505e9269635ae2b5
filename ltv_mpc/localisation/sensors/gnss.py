"""Satellite fix: position and velocity over ground, north and east, of the antenna at lever arm l.

z = [p + q, v + s] + n, north and east of each,  q = R l,  s = R (w x l)
Partials in ``lever_arm.py``.
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.localisation.filter.state import ATTITUDE, GYRO_BIAS, Belief
from ltv_mpc.localisation.sensor_config import Gnss
from ltv_mpc.localisation.sensors import lever_arm
from ltv_mpc.localisation.sensors.rows import Rows
from ltv_mpc.messages import GnssFix, Triple

_TURNING = (*range(ATTITUDE.start, ATTITUDE.stop), *range(GYRO_BIAS.start, GYRO_BIAS.stop))
_STATES = np.array([[own, *_TURNING] for own in (0, 1, 3, 4)])


def rows(belief: Belief, fix: GnssFix, gnss: Gnss, rate: Triple) -> Rows:
    """Four rows; ``rate`` is the angular rate that the unit measured, bias included (rad/s, body)."""
    antenna = lever_arm.point(belief, gnss.lever_arm_m)
    swing = lever_arm.swing(belief, gnss.lever_arm_m, rate)
    partial = np.zeros((4, 7))
    partial[:, 0] = 1.0
    partial[:2, 1:4] = antenna.by_attitude[:2]
    partial[2:, 1:4] = swing.by_attitude[:2]
    partial[2:, 4:7] = swing.by_gyro_bias[:2]
    z = np.array([fix.north_m, fix.east_m, fix.velocity_north_mps, fix.velocity_east_mps])
    p, v = gnss.position_sd_m**2, gnss.velocity_sd_mps**2
    return Rows(
        state=_STATES,
        partial=partial,
        residual=z - belief.x[_STATES[:, 0]] - np.concatenate([antenna.offset[:2], swing.velocity[:2]]),
        variance=np.array([p, p, v, v]),
    )
