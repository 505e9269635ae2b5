"""What is published of a filter: where the vehicle is and how it moves, how sure of that, and the water about it.

Rate        w = w_m - b_g - R^T W                              against NED, body axes; W: the Earth's
            heading' = (w_y sin roll + w_z cos roll) / cos pitch
Covariance  J P J^T of [n, e, v_n, v_e, heading, heading'], J by the fifteen core states; the gyros' white noise is new
            in each sample, and is added to that of heading'
"""

from __future__ import annotations

import math

import numpy as np

from ltv_mpc.frames import roll_pitch_heading
from ltv_mpc.jit import copy_to, jit
from ltv_mpc.localisation.filter.error_state_filter import Filter
from ltv_mpc.localisation.filter.state import ATTITUDE, CORE, GYRO_BIAS
from ltv_mpc.localisation.sensors.compass import heading_partials
from ltv_mpc.localisation.water import current_model
from ltv_mpc.messages import Array, Estimate, Triple

_TILT, _GYRO = ATTITUDE.start, GYRO_BIAS.start


def estimate(filter_: Filter, depth_m: Array) -> Estimate:
    """At the time of its belief. ``depth_m`` is the water's grid."""
    belief = filter_.belief
    heading, yaw_rate, covariance = _angles(
        belief.x, belief.R, filter_.rate, filter_.rotation_of_earth, filter_.core_covariance(), filter_.rate_variance
    )
    north, east, down, v_north, v_east, v_down = belief.x[:6].tolist()
    return Estimate(
        t_ns=belief.t_ns,
        north_m=north,
        east_m=east,
        heading_rad=heading,
        yaw_rate_radps=yaw_rate,
        velocity_north_mps=v_north,
        velocity_east_mps=v_east,
        depth_m=down,
        velocity_down_mps=v_down,
        covariance=covariance,
        current=current_model.profile(belief, depth_m),
    )


@jit
def _angles(x: Array, R: Array, rate: Triple, W: Array, C: Array, noise: float) -> tuple[float, float, Array]:
    """Heading, its rate, and the covariance (6, 6), of x, R, the measured rate, the core's covariance C (15, 15) and
    the variance of the gyros' white noise.
    """
    roll, pitch, heading = roll_pitch_heading(R)
    w = np.empty(3)
    for i in range(3):
        w[i] = rate[i] - x[_GYRO + i] - (R[0, i] * W[0] + R[1, i] * W[1] + R[2, i] * W[2])
    y, z = math.sin(roll) / math.cos(pitch), math.cos(roll) / math.cos(pitch)
    by_tilt = heading_partials(R)
    JC, at = np.empty((6, CORE)), (0, 1, 3, 4)
    for i in range(4):
        copy_to(JC[i], C[at[i]])
    for j in range(CORE):
        JC[4, j] = by_tilt[0] * C[_TILT, j] + by_tilt[1] * C[_TILT + 1, j] + by_tilt[2] * C[_TILT + 2, j]
        JC[5, j] = -y * C[_GYRO + 1, j] - z * C[_GYRO + 2, j]
    out = np.empty((6, 6))
    for i in range(6):
        for j in range(4):
            out[i, j] = JC[i, at[j]]
        out[i, 4] = by_tilt[0] * JC[i, _TILT] + by_tilt[1] * JC[i, _TILT + 1] + by_tilt[2] * JC[i, _TILT + 2]
        out[i, 5] = -y * JC[i, _GYRO + 1] - z * JC[i, _GYRO + 2]
    out[5, 5] += noise * (y * y + z * z)
    return heading, y * w[1] + z * w[2], 0.5 * (out + out.T)
