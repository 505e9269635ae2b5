"""Satellite position and velocity, while the vehicle is at the surface: t <= 0.

p_m = p + R l + N(0, sd_p^2),  v_m = v + R (w x l) + N(0, sd_v^2),  north and east, white from fix to fix
"""

from __future__ import annotations

from ltv_mpc.localisation.sensors.gnss import Gnss
from ltv_mpc.messages import GnssFix
from sim.random_streams import Stream, generator
from sim.sensors.vehicle_state import VehicleState


class GnssReceiver:
    """Satellite receiver with its antenna at lever arm l of the vehicle."""

    def __init__(self, settings: Gnss, seed: int) -> None:
        """Create a receiver that draws its noise from a stream of its own."""
        self._settings, self._draws = settings, generator(seed, Stream.GNSS)

    def sample(self, now: VehicleState) -> list[GnssFix]:
        """Return a fix while the vehicle is at the surface."""
        if now.t_ns > 0:
            return []
        lever = self._settings.lever_arm_m
        antenna, velocity = now.point_m(lever), now.point_velocity_mps(lever)
        p, q, v, w = self._draws.standard_normal(4).tolist()
        sd_m, sd_mps = self._settings.position_sd_m, self._settings.velocity_sd_mps
        return [
            GnssFix(
                t_ns=now.t_ns,
                north_m=antenna[0] + sd_m * p,
                east_m=antenna[1] + sd_m * q,
                velocity_north_mps=velocity[0] + sd_mps * v,
                velocity_east_mps=velocity[1] + sd_mps * w,
            )
        ]
