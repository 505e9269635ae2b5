"""Ultra-short baseline: position over ground, north and east, of the beacon at lever arm l, measured from a ship.

z = p + q + n, q = R l;  n ~ N(0, sd_p^2 + (sd_bearing r)^2) north and east. r is the slant range from the ship, at the
surface at the position in the sensors file, to the estimated position of the beacon. Partials in ``lever_arm.py``.
"""

from __future__ import annotations

import math

import numpy as np

from ltv_mpc.localisation.filter.state import ATTITUDE, POSITION, Belief
from ltv_mpc.localisation.sensors import lever_arm
from ltv_mpc.localisation.sensors.sensor import Availability, Context, Linearised, Rows, Sensor
from ltv_mpc.localisation.sensors.settings import Coordinate, Latency, Lever, PositiveSd, Sd, SensorSettings, Share
from ltv_mpc.messages import UsblFix

_STATES = np.array([np.r_[own, ATTITUDE] for own in (0, 1)])


class Usbl(SensorSettings, frozen=True, kw_only=True):
    """Ultra-short baseline: a ship measures the position of the vehicle, and sends it to the vehicle."""

    latency_ns: Latency
    ship_m: tuple[Coordinate, Coordinate]  # north, east
    position_sd_m: PositiveSd
    bearing_sd_rad: Sd  # times the slant range; added to the standard deviation in quadrature
    missing_share: Share
    outlier_share: Share
    outlier_m: Sd
    lever_arm_m: Lever = (0.0, 0.0, 0.0)


def linearise(belief: Belief, fix: UsblFix, usbl: Usbl, _: Context) -> Linearised:
    """Linearise a position from a ship about the belief.

    Parameters
    ----------
    belief : the filter's belief at the fix's time.
    fix : position of the beacon, north and east (m).
    usbl : settings: position of the ship, and the standard deviations.

    Returns
    -------
    Two rows: north, east.
    """
    beacon = lever_arm.point(belief, usbl.lever_arm_m)
    north, east, down = (belief.x[POSITION] + beacon.offset).tolist()
    slant = math.hypot(north - usbl.ship_m[0], east - usbl.ship_m[1], down)
    partial = np.zeros((2, 4))
    partial[:, 0] = 1.0
    partial[:, 1:] = beacon.by_attitude[:2]
    rows = Rows(
        state=_STATES,
        partial=partial,
        residual=np.array([fix.north_m - north, fix.east_m - east]),
        variance=np.full(2, usbl.position_sd_m**2 + (usbl.bearing_sd_rad * slant) ** 2),
    )
    return Linearised(rows=rows)


USBL = Sensor(
    name="usbl",
    message=UsblFix,
    settings=Usbl,
    scalars_per_message=2,
    at_rest=lambda t_ns, _: UsblFix(t_ns=t_ns, north_m=0.0, east_m=0.0),
    linearise=linearise,
    availability=Availability.INTERMITTENT,
)
