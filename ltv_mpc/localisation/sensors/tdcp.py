"""Time-differenced carrier phase: the change of the antenna's position since the last satellite epoch.

z = [p_n + q_n - e_n, p_e + q_e - e_e] + n, q = R l, where e is the clone of the antenna's position that the filter made
at that epoch; partials in ``lever_arm.py``
Source  Medagoda & Williams 2012, section III; the clone is a stochastic clone (Roumeliotis & Burdick 2002).
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.localisation.filter.state import ATTITUDE, Belief
from ltv_mpc.localisation.sensors import lever_arm
from ltv_mpc.localisation.sensors.sensor import Availability, Context, Linearised, Rows, Sensor, unusable
from ltv_mpc.localisation.sensors.settings import Latency, PositiveSd, SensorSettings
from ltv_mpc.messages import TdcpFix


class Tdcp(SensorSettings, frozen=True, kw_only=True):
    """Change of position from carrier phase, at the surface, between epochs one period apart."""

    displacement_sd_m: PositiveSd
    latency_ns: Latency = 0


def linearise(belief: Belief, fix: TdcpFix, tdcp: Tdcp, context: Context) -> Linearised:
    """Linearise a displacement about the belief.

    Parameters
    ----------
    belief : the filter's belief at the fix's time.
    fix : displacement of the antenna, north and east (m).
    tdcp : settings of the carrier phase measurement.
    context : lever arm of the satellite receiver's antenna.

    Returns
    -------
    Two rows: north, east; none if the clone is of another epoch than that at which the displacement begins.
    """
    if fix.from_t_ns != belief.epoch_t_ns:
        return unusable("other_epoch", 2)
    e = belief.layout.epoch.start
    antenna = lever_arm.point(belief, context.sensor_config.gnss.lever_arm_m)
    (q_n, q_e, _), by = antenna.offset, antenna.by_attitude
    x = belief.x
    rows = Rows(
        state=np.array([np.r_[0, e, ATTITUDE], np.r_[1, e + 1, ATTITUDE]]),
        partial=np.array([[1.0, -1.0, *by[0]], [1.0, -1.0, *by[1]]]),
        residual=np.array([fix.north_m - (x[0] + q_n - x[e]), fix.east_m - (x[1] + q_e - x[e + 1])]),
        variance=np.full(2, tdcp.displacement_sd_m**2),
    )
    return Linearised(rows=rows)


TDCP = Sensor(
    name="tdcp",
    message=TdcpFix,
    settings=Tdcp,
    scalars_per_message=2,
    at_rest=lambda t_ns, tdcp: TdcpFix(t_ns=t_ns, from_t_ns=t_ns - tdcp.period_ns, north_m=0.0, east_m=1e-15 * t_ns),
    linearise=linearise,
    availability=Availability.SURFACE,
    clones_position=True,
    reading=lambda fix: (fix.north_m, fix.east_m),
)
