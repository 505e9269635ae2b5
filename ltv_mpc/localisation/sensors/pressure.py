"""Depth from pressure: of the gauge at lever arm l, positive down.

z = p_d + q_d + n,  q = R l,  dz = dp_d + phi_n q_e - phi_e q_n        (phi x q, ``lever_arm.py``)
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.jit import jit
from ltv_mpc.localisation.filter.state import ATTITUDE, Belief
from ltv_mpc.localisation.sensor_config import Pressure
from ltv_mpc.localisation.sensors.rows import Rows
from ltv_mpc.messages import Array, PressureDepth, Triple

_STATE = np.array([[2, ATTITUDE.start, ATTITUDE.start + 1]])


def rows(belief: Belief, depth: PressureDepth, pressure: Pressure) -> Rows:
    """One row."""
    partial, residual, variance = _row(belief.x, belief.R, pressure.lever_arm_m, depth.depth_m, pressure.depth_sd_m)
    return Rows(_STATE, partial, residual, variance)


@jit
def _row(x: Array, R: Array, l: Triple, depth_m: float, sd_m: float) -> tuple[Array, Array, Array]:  # noqa: E741
    """Partials (1, 3), residual (1,), variance (1,)."""
    q_n = R[0, 0] * l[0] + R[0, 1] * l[1] + R[0, 2] * l[2]
    q_e = R[1, 0] * l[0] + R[1, 1] * l[1] + R[1, 2] * l[2]
    q_d = R[2, 0] * l[0] + R[2, 1] * l[1] + R[2, 2] * l[2]
    partial = np.empty((1, 3))
    partial[0, 0], partial[0, 1], partial[0, 2] = 1.0, q_e, -q_n
    return partial, np.full(1, depth_m - x[2] - q_d), np.full(1, sd_m * sd_m)
