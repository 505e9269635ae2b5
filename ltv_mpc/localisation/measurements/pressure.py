"""Depth from pressure: of the vehicle's origin, positive down.

z = p_d + n
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.localisation.measurements.rows import Rows
from ltv_mpc.localisation.state import Belief
from ltv_mpc.localisation.suite import Pressure
from ltv_mpc.signals import PressureDepth

_STATE = np.array([[2]])


def rows(belief: Belief, depth: PressureDepth, pressure: Pressure) -> Rows:
    """One row."""
    return Rows(
        state=_STATE,
        partial=np.ones((1, 1)),
        residual=np.array([depth.depth_m - belief.x[2]]),
        variance=np.array([pressure.depth_sd_m**2]),
    )
