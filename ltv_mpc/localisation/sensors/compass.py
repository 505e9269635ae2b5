"""Heading of the vehicle's forward axis, with a bias that drifts slowly.

z = heading(R) + b + n,  heading = atan2(a_e, a_n) with a = R [1, 0, 0] the forward axis in NED
dz = phi_d - (a_n a_d phi_n + a_e a_d phi_e) / (a_n^2 + a_e^2) + db     (a + phi x a)
"""

from __future__ import annotations

import math

import numpy as np

from ltv_mpc.frames import wrap_angle
from ltv_mpc.jit import jit
from ltv_mpc.localisation.filter.state import ATTITUDE, Belief
from ltv_mpc.localisation.sensor_config import Compass
from ltv_mpc.localisation.sensors.rows import Rows
from ltv_mpc.messages import Array, CompassHeading


def heading(R: Array) -> float:
    """Of the forward axis (rad), (-pi, pi]."""
    return math.atan2(R[1, 0], R[0, 0])


@jit
def heading_partials(R: Array) -> Array:
    """d heading / d phi, (3,)."""
    n, e, d = R[0, 0], R[1, 0], R[2, 0]
    h2 = n * n + e * e
    return np.array([-n * d / h2, -e * d / h2, 1.0])


def rows(belief: Belief, compass_heading: CompassHeading, compass: Compass) -> Rows:
    """One row."""
    bias = belief.layout.compass_bias
    state = np.array([[*range(ATTITUDE.start, ATTITUDE.stop), *range(bias.start, bias.stop)]])
    partial = np.ones((1, state.shape[1]))
    partial[0, :3] = heading_partials(belief.R)
    expected = heading(belief.R) + float(belief.x[bias].sum())
    return Rows(
        state=state,
        partial=partial,
        residual=np.array([wrap_angle(compass_heading.heading_rad - expected)]),
        variance=np.array([compass.heading_sd_rad**2]),
    )
