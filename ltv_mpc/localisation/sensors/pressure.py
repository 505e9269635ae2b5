"""Depth from pressure, of the gauge at lever arm l, positive down.

z = p_d + q_d + n,  q = R l,  dz = dp_d + phi_n q_e - phi_e q_n        (phi x q, ``lever_arm.py``)
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.localisation.filter.state import ATTITUDE, Belief
from ltv_mpc.localisation.sensors import lever_arm
from ltv_mpc.localisation.sensors.sensor import Context, Linearised, Rows, Sensor
from ltv_mpc.localisation.sensors.settings import Latency, Lever, PositiveSd, SensorSettings
from ltv_mpc.messages import PressureDepth

_STATE = np.array([[2, ATTITUDE.start, ATTITUDE.start + 1]])


class Pressure(SensorSettings, frozen=True, kw_only=True):
    """Pressure gauge."""

    depth_sd_m: PositiveSd
    latency_ns: Latency = 0
    lever_arm_m: Lever = (0.0, 0.0, 0.0)


def linearise(belief: Belief, depth: PressureDepth, pressure: Pressure, _: Context) -> Linearised:
    """Linearise a depth about the belief.

    Parameters
    ----------
    belief : the filter's belief at the measurement's time.
    depth : depth of the gauge (m, positive down).
    pressure : settings of the gauge.

    Returns
    -------
    One row.
    """
    gauge = lever_arm.point(belief, pressure.lever_arm_m)
    rows = Rows(
        state=_STATE,
        partial=np.array([[1.0, *gauge.by_attitude[2, :2]]]),
        residual=np.array([depth.depth_m - belief.x[2] - gauge.offset[2]]),
        variance=np.array([pressure.depth_sd_m**2]),
    )
    return Linearised(rows=rows)


PRESSURE = Sensor(
    name="pressure",
    message=PressureDepth,
    settings=Pressure,
    scalars_per_message=1,
    at_rest=lambda t_ns, _: PressureDepth(t_ns=t_ns, depth_m=0.0),
    linearise=linearise,
    is_essential=True,
)
