"""Time-differenced carrier phase: the change of the antenna's position since the last satellite epoch.

z = [p_n + q_n - e_n, p_e + q_e - e_e] + n, q = R l, where e is the clone of the antenna's position that the filter made
at that epoch; partials in ``lever_arm.py``
Source  Medagoda & Williams 2012, section III; the clone is a stochastic clone (Roumeliotis & Burdick 2002).
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.localisation.filter.state import ATTITUDE, Belief
from ltv_mpc.localisation.sensor_config import Tdcp
from ltv_mpc.localisation.sensors import lever_arm
from ltv_mpc.localisation.sensors.rows import Rows
from ltv_mpc.messages import TdcpFix, Triple


def rows(belief: Belief, fix: TdcpFix, tdcp: Tdcp, antenna_m: Triple) -> Rows:
    """Two rows; the antenna is the satellite receiver's. The caller has made sure that the clone is of that epoch."""
    e = belief.layout.epoch.start
    attitude = range(ATTITUDE.start, ATTITUDE.stop)
    antenna = lever_arm.point(belief, antenna_m)
    (q_n, q_e, _), by = antenna.offset, antenna.by_attitude
    x = belief.x
    return Rows(
        state=np.array([[0, e, *attitude], [1, e + 1, *attitude]]),
        partial=np.array([[1.0, -1.0, *by[0]], [1.0, -1.0, *by[1]]]),
        residual=np.array([fix.north_m - (x[0] + q_n - x[e]), fix.east_m - (x[1] + q_e - x[e + 1])]),
        variance=np.full(2, tdcp.displacement_sd_m**2),
    )
