"""Depth from pressure: of the gauge at lever arm l, positive down.

z = p_d + q_d + n,  q = R l;  partials in ``lever.py``
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.localisation.measurements import lever
from ltv_mpc.localisation.measurements.rows import Rows
from ltv_mpc.localisation.state import ATTITUDE, Belief
from ltv_mpc.localisation.suite import Pressure
from ltv_mpc.signals import PressureDepth

_STATE = np.array([[2, *range(ATTITUDE.start, ATTITUDE.stop)]])


def rows(belief: Belief, depth: PressureDepth, pressure: Pressure) -> Rows:
    """One row."""
    gauge = lever.point(belief, pressure.lever_arm_m)
    return Rows(
        state=_STATE,
        partial=np.array([[1.0, *gauge.by_attitude[2]]]),
        residual=np.array([depth.depth_m - belief.x[2] - gauge.offset[2]]),
        variance=np.array([pressure.depth_sd_m**2]),
    )
