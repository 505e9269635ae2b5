"""Time-differenced carrier phase: the antenna's displacement since the last epoch, at the surface: t <= 0.

d_m = a(t) - a(t - period) + N(0, sd^2),  a = p + R l,  north and east, white from fix to fix
"""

from __future__ import annotations

from ltv_mpc.localisation.sensors.tdcp import Tdcp
from ltv_mpc.messages import TdcpFix, Triple
from sim.random_streams import Stream, generator
from sim.sensors.vehicle_state import VehicleState


class CarrierPhaseReceiver:
    """Carrier phase receiver. Its first message needs two epochs: a surface phase of 1 s at 1 Hz has one, at t = 0."""

    def __init__(self, settings: Tdcp, seed: int, antenna_m: Triple = (0.0, 0.0, 0.0)) -> None:
        """Create a receiver that draws its noise from a stream of its own; ``antenna_m`` is the GNSS lever arm."""
        self._sd, self._draws = settings.displacement_sd_m, generator(seed, Stream.TDCP)
        self._antenna = antenna_m
        self._last: tuple[int, Triple] | None = None

    def sample(self, now: VehicleState) -> list[TdcpFix]:
        """Return the displacement since the last epoch while the vehicle is at the surface."""
        if now.t_ns > 0:
            return []
        here = now.point_m(self._antenna)
        last, self._last = self._last, (now.t_ns, here)
        if last is None:
            return []
        from_ns, there = last
        p, q = self._draws.standard_normal(2).tolist()
        return [
            TdcpFix(
                t_ns=now.t_ns,
                from_t_ns=from_ns,
                north_m=here[0] - there[0] + self._sd * p,
                east_m=here[1] - there[1] + self._sd * q,
            )
        ]
