"""Depth from pressure: z_m = z + N(0, sd^2), white; afloat it may read a little above the surface."""

from __future__ import annotations

from ltv_mpc.localisation.suite import Pressure
from ltv_mpc.signals import PressureDepth
from sim.draws import Stream, generator
from sim.sensors.instant import Instant


class Gauge:
    """At the vehicle's origin."""

    def __init__(self, settings: Pressure, seed: int) -> None:
        """Noise is drawn from the gauge's own stream."""
        self._sd, self._draws = settings.depth_sd_m, generator(seed, Stream.PRESSURE)

    def sample(self, now: Instant) -> list[PressureDepth]:
        """Depth now."""
        return [
            PressureDepth(t_ns=now.t_ns, depth_m=now.position_m[2] + self._sd * float(self._draws.standard_normal()))
        ]
