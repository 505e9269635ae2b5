"""Satellite fix: position and velocity over ground, north and east, of the antenna at lever arm l.

z = [p + q, v + s] + n, north and east of each,  q = R l,  s = R (w x l)
Partials in ``lever_arm.py``.
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.localisation.filter.state import ATTITUDE, GYRO_BIAS, Belief
from ltv_mpc.localisation.sensors import lever_arm
from ltv_mpc.localisation.sensors.sensor import Availability, Context, Linearised, Rows, Sensor
from ltv_mpc.localisation.sensors.settings import Latency, Lever, PositiveSd, SensorSettings
from ltv_mpc.messages import GnssFix

_STATES = np.array([np.r_[own, ATTITUDE, GYRO_BIAS] for own in (0, 1, 3, 4)])


class Gnss(SensorSettings, frozen=True, kw_only=True):
    """Satellite position and velocity, at the surface."""

    position_sd_m: PositiveSd
    velocity_sd_mps: PositiveSd
    latency_ns: Latency = 0
    lever_arm_m: Lever = (0.0, 0.0, 0.0)


def linearise(belief: Belief, fix: GnssFix, gnss: Gnss, context: Context) -> Linearised:
    """Linearise a satellite fix about the belief.

    Parameters
    ----------
    belief : the filter's belief at the fix's time.
    fix : position (m) and velocity (m/s) of the antenna, north and east.
    gnss : settings of the receiver.
    context : angular rate that the inertial unit measured.

    Returns
    -------
    Four rows: position north, east, velocity north, east.
    """
    antenna = lever_arm.point(belief, gnss.lever_arm_m)
    swing = lever_arm.swing(belief, gnss.lever_arm_m, context.rate)
    partial = np.zeros((4, 7))
    partial[:, 0] = 1.0
    partial[:2, 1:4] = antenna.by_attitude[:2]
    partial[2:, 1:4] = swing.by_attitude[:2]
    partial[2:, 4:7] = swing.by_gyro_bias[:2]
    z = np.array([fix.north_m, fix.east_m, fix.velocity_north_mps, fix.velocity_east_mps])
    p, v = gnss.position_sd_m**2, gnss.velocity_sd_mps**2
    rows = Rows(
        state=_STATES,
        partial=partial,
        residual=z - belief.x[_STATES[:, 0]] - np.concatenate([antenna.offset[:2], swing.velocity[:2]]),
        variance=np.array([p, p, v, v]),
    )
    return Linearised(rows=rows)


GNSS = Sensor(
    name="gnss",
    message=GnssFix,
    settings=Gnss,
    scalars_per_message=4,
    at_rest=lambda t_ns, _: GnssFix(
        t_ns=t_ns, north_m=0.0, east_m=0.0, velocity_north_mps=0.0, velocity_east_mps=1e-15 * t_ns
    ),
    linearise=linearise,
    availability=Availability.SURFACE,
    clones_position=True,
    reading=lambda fix: (fix.north_m, fix.east_m, fix.velocity_north_mps, fix.velocity_east_mps),
)
