"""Magnetic compass: heading_m = heading + b(t) + N(0, sd^2), wrapped; the bias b drifts (first-order Gauss-Markov)."""

from __future__ import annotations

from ltv_mpc.frames import roll_pitch_heading, wrap_angle
from ltv_mpc.localisation.sensors.compass import Compass
from ltv_mpc.messages import CompassHeading
from sim.random_streams import Stream, generator
from sim.sensors.simulated import GaussMarkovBias
from sim.sensors.vehicle_state import VehicleState


class MagneticCompass:
    """Tilt-compensated compass: roll and pitch do not enter."""

    def __init__(self, settings: Compass, seed: int) -> None:
        """Draw the first bias from the compass's own stream."""
        self._sd, self._draws = settings.heading_sd_rad, generator(seed, Stream.COMPASS)
        self._bias = GaussMarkovBias(settings.bias_sd_rad, settings.bias_tau_s, 1, self._draws)
        self._last_ns: int | None = None

    @property
    def bias_rad(self) -> float:
        """True bias of the last heading."""
        return float(self._bias.value[0])

    def sample(self, now: VehicleState) -> list[CompassHeading]:
        """Return the heading now."""
        noise = self._sd * float(self._draws.standard_normal())
        bias = self._bias.value if self._last_ns is None else self._bias.advance((now.t_ns - self._last_ns) * 1e-9)
        self._last_ns = now.t_ns
        heading = roll_pitch_heading(now.rotation)[2]
        return [CompassHeading(t_ns=now.t_ns, heading_rad=wrap_angle(heading + float(bias[0]) + noise))]
