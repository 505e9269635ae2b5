"""Heading of the vehicle's forward axis, with a bias that drifts slowly.

z = heading(R) + b + n,  heading = atan2(a_e, a_n) with a = R [1, 0, 0] the forward axis in NED
dz = phi_d - (a_n a_d phi_n + a_e a_d phi_e) / (a_n^2 + a_e^2) + db     (a + phi x a)
"""

from __future__ import annotations

import math

import numpy as np

from ltv_mpc.frames import wrap_angle
from ltv_mpc.localisation.filter.state import ATTITUDE, Belief
from ltv_mpc.localisation.sensors.sensor import Context, Linearised, Rows, Sensor
from ltv_mpc.localisation.sensors.settings import Latency, PositiveSd, Sd, Seconds, SensorSettings
from ltv_mpc.messages import Array, CompassHeading


class Compass(SensorSettings, frozen=True, kw_only=True):
    """Magnetic compass."""

    heading_sd_rad: PositiveSd
    bias_sd_rad: Sd
    bias_tau_s: Seconds
    latency_ns: Latency = 0


def heading(R: Array) -> float:
    """Return the heading of the forward axis (rad), in (-pi, pi], for an attitude R (3, 3), body to NED."""
    return math.atan2(R[1, 0], R[0, 0])


def heading_partials(R: Array) -> Array:
    """Return d heading / d phi, (3,), for an attitude R (3, 3), body to NED."""
    n, e, d = R[0, 0], R[1, 0], R[2, 0]
    h2 = n * n + e * e
    return np.array([-n * d / h2, -e * d / h2, 1.0])


def linearise(belief: Belief, compass_heading: CompassHeading, compass: Compass, _: Context) -> Linearised:
    """Linearise a heading about the belief.

    Parameters
    ----------
    belief : the filter's belief at the measurement's time.
    compass_heading : heading (rad).
    compass : settings of the compass.

    Returns
    -------
    One row.
    """
    bias = belief.layout.compass_bias
    state = np.array([[*range(ATTITUDE.start, ATTITUDE.stop), *range(bias.start, bias.stop)]])
    partial = np.ones((1, state.shape[1]))
    partial[0, :3] = heading_partials(belief.R)
    expected = heading(belief.R) + float(belief.x[bias].sum())
    rows = Rows(
        state=state,
        partial=partial,
        residual=np.array([wrap_angle(compass_heading.heading_rad - expected)]),
        variance=np.array([compass.heading_sd_rad**2]),
    )
    return Linearised(rows=rows)


COMPASS = Sensor(
    name="compass",
    message=CompassHeading,
    settings=Compass,
    scalars_per_message=1,
    at_rest=lambda t_ns, _: CompassHeading(t_ns=t_ns, heading_rad=0.0),
    linearise=linearise,
)
