"""Satellite fix: position and velocity over ground, north and east, of the vehicle's origin.

z = [p_n, p_e, v_n, v_e] + n
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.localisation.measurements.rows import Rows
from ltv_mpc.localisation.state import Belief
from ltv_mpc.localisation.suite import Gnss
from ltv_mpc.signals import GnssFix

_STATES = np.array([[0], [1], [3], [4]])


def rows(belief: Belief, fix: GnssFix, gnss: Gnss) -> Rows:
    """Four rows."""
    z = np.array([fix.north_m, fix.east_m, fix.velocity_north_mps, fix.velocity_east_mps])
    p, v = gnss.position_sd_m**2, gnss.velocity_sd_mps**2
    return Rows(
        state=_STATES,
        partial=np.ones((4, 1)),
        residual=z - belief.x[_STATES[:, 0]],
        variance=np.array([p, p, v, v]),
    )
