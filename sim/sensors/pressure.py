"""Depth from pressure: z_m = z + (R l)_down + N(0, sd^2), white; at the surface it may be a little negative."""

from __future__ import annotations

from ltv_mpc.localisation.sensors.pressure import Pressure
from ltv_mpc.messages import PressureDepth
from sim.random_streams import Stream, generator
from sim.sensors.vehicle_state import VehicleState


class PressureGauge:
    """Pressure gauge at lever arm l of the vehicle."""

    def __init__(self, settings: Pressure, seed: int) -> None:
        """Create a gauge that draws its noise from a stream of its own."""
        self._settings, self._draws = settings, generator(seed, Stream.PRESSURE)

    def sample(self, now: VehicleState) -> list[PressureDepth]:
        """Return the depth now."""
        noise = self._settings.depth_sd_m * float(self._draws.standard_normal())
        return [PressureDepth(t_ns=now.t_ns, depth_m=now.point_m(self._settings.lever_arm_m)[2] + noise)]
