"""Ultra-short baseline: a ship at the surface measures the position of the vehicle's beacon, and sends it down.

Beacon  a = p + R l;  ship S = [north, east, 0], known without error
Truth   a, north and east; the vehicle knows its depth better
Errors  + N(0, sd_p^2 + (sd_bearing |a - S|)^2)        north and east, white; the angle's part grows with the range
        +- outlier                                     on a share of the fixes: a reflection instead of the beacon
Lost    a share of the fixes; all fixes while the beacon is out of the water
The message arrives ``latency_ns`` after its validity: sound on its way up, processing on the ship, transmission down.
"""

from __future__ import annotations

import math

from ltv_mpc.localisation.sensors.usbl import Usbl
from ltv_mpc.messages import UsblFix
from sim.random_streams import Stream, generator
from sim.sensors.simulated import outliers
from sim.sensors.vehicle_state import VehicleState


class ShipTransceiver:
    """USBL transceiver on a ship."""

    def __init__(self, settings: Usbl, seed: int) -> None:
        """Create a transceiver that draws noise, losses and outliers from a stream of its own."""
        self._settings, self._draws = settings, generator(seed, Stream.USBL)

    def sample(self, now: VehicleState) -> list[UsblFix]:
        """Return the position of the beacon as the ship measures it now."""
        settings = self._settings
        # Everything is drawn at every fix, so that no setting changes the random numbers of another.
        noise = self._draws.standard_normal(2)
        lost = self._draws.random() < settings.missing_share
        uniform = self._draws.random(2)
        beacon = now.point_m(settings.lever_arm_m)
        if lost or beacon[2] <= 0.0:
            return []
        slant = math.dist(beacon, (*settings.ship_m, 0.0))
        error = math.hypot(settings.position_sd_m, settings.bearing_sd_rad * slant) * noise
        error += settings.outlier_m * outliers(uniform, settings.outlier_share)
        north, east = error.tolist()
        return [UsblFix(t_ns=now.t_ns, north_m=beacon[0] + north, east_m=beacon[1] + east)]
