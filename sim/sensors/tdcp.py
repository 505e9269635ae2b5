"""Time-differenced carrier phase: the change of position since the epoch before, while the vehicle is afloat: t <= 0.

d_m = p(t) - p(t - period) + N(0, sd^2),  north and east, white from fix to fix
"""

from __future__ import annotations

from ltv_mpc.localisation.suite import Tdcp
from ltv_mpc.signals import TdcpFix
from sim.draws import Stream, generator
from sim.sensors.instant import Instant


class CarrierPhase:
    """Two epochs make the first fix: a surface phase of 1 s at 1 Hz has one, at t = 0."""

    def __init__(self, settings: Tdcp, seed: int) -> None:
        """Noise is drawn from its own stream."""
        self._sd, self._draws = settings.displacement_sd_m, generator(seed, Stream.TDCP)
        self._last: Instant | None = None

    def sample(self, now: Instant) -> list[TdcpFix]:
        """The way since the last epoch, as long as there are satellites."""
        if now.t_ns > 0:
            return []
        last, self._last = self._last, now
        if last is None:
            return []
        p, q = self._draws.standard_normal(2).tolist()
        return [
            TdcpFix(
                t_ns=now.t_ns,
                from_t_ns=last.t_ns,
                north_m=now.position_m[0] - last.position_m[0] + self._sd * p,
                east_m=now.position_m[1] - last.position_m[1] + self._sd * q,
            )
        ]
