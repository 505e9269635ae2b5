"""Depth from pressure, of the gauge at lever arm l, positive down.

z = p_d + q_d + n,  q = R l,  dz = dp_d + phi_n q_e - phi_e q_n        (phi x q, ``lever_arm.py``)
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.jit import jit
from ltv_mpc.localisation.filter.state import ATTITUDE, Belief
from ltv_mpc.localisation.sensors.rows import Linearised, Rows
from ltv_mpc.localisation.sensors.sensor import Context, Sensor
from ltv_mpc.localisation.sensors.settings import Latency, Lever, PositiveSd, SensorSettings
from ltv_mpc.messages import Array, PressureDepth, Triple

_STATE = np.array([[2, ATTITUDE.start, ATTITUDE.start + 1]])


class Pressure(SensorSettings, frozen=True, kw_only=True):
    """Pressure gauge."""

    depth_sd_m: PositiveSd
    latency_ns: Latency = 0
    lever_arm_m: Lever = (0.0, 0.0, 0.0)


def rows(belief: Belief, depth: PressureDepth, pressure: Pressure) -> Rows:
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
    partial, residual, variance = _row(belief.x, belief.R, pressure.lever_arm_m, depth.depth_m, pressure.depth_sd_m)
    return Rows(_STATE, partial, residual, variance)


@jit
def _row(x: Array, R: Array, l: Triple, depth_m: float, sd_m: float) -> tuple[Array, Array, Array]:  # noqa: E741
    """Return partials (1, 3), residual (1,) and variance (1,)."""
    q_n = R[0, 0] * l[0] + R[0, 1] * l[1] + R[0, 2] * l[2]
    q_e = R[1, 0] * l[0] + R[1, 1] * l[1] + R[1, 2] * l[2]
    q_d = R[2, 0] * l[0] + R[2, 1] * l[1] + R[2, 2] * l[2]
    partial = np.empty((1, 3))
    partial[0, 0], partial[0, 1], partial[0, 2] = 1.0, q_e, -q_n
    return partial, np.full(1, depth_m - x[2] - q_d), np.full(1, sd_m * sd_m)


def _linearise(belief: Belief, depth: PressureDepth, pressure: Pressure, _: Context) -> Linearised:
    return Linearised(rows=rows(belief, depth, pressure))


PRESSURE = Sensor(
    name="pressure",
    message=PressureDepth,
    settings=Pressure,
    scalars_per_message=1,
    at_rest=lambda t_ns, _: PressureDepth(t_ns=t_ns, depth_m=0.0),
    linearise=_linearise,
    is_essential=True,
)
