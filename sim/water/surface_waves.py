"""Surface waves: the orbital velocity of one regular wave in deep water (linear theory).

    c(z, t) = pi H / T exp(-k z) d sin(2 pi t / T + phase),   k = (2 pi / T)^2 / g,   d = [cos direction, sin direction]

H is the height between crest and lowest point, T the period; the phase comes from the seed. A vehicle that is small
beside the wavelength, 1.56 m/s^2 T^2, is carried along with the water: the pressure of the accelerated water on the
hull replaces the inertia of the displaced mass. So the velocity enters the kinematics and the drag, and its time
derivative adds no force. The vehicle is taken to stay within a fraction of a wavelength, and vertical velocity, yaw and
the slow drift of second order are left out.

Source  Faltinsen 1990, Sea Loads on Ships and Offshore Structures, chapters 2 and 3.
"""

from __future__ import annotations

import math

from ltv_mpc.messages import Triple
from sim.random_streams import Stream, generator
from sim.scenario import GRAVITY_MPS2
from sim.scenario import SurfaceWaves as Settings


class SurfaceWaves:
    """Regular surface wave of one run, from the settings' table [water.surface_waves]."""

    def __init__(self, settings: Settings, seed: int) -> None:
        """Take the settings and draw the phase."""
        self._rate = 2.0 * math.pi / settings.period_s
        self._phase = float(generator(seed, Stream.SURFACE_WAVES).uniform(0.0, 2.0 * math.pi))
        speed = math.pi * settings.height_m / settings.period_s
        self._north_mps = speed * math.cos(settings.direction_rad)
        self._east_mps = speed * math.sin(settings.direction_rad)

    def at(self, t_ns: int) -> Triple:
        """Return the velocity north and east at the surface (m/s), and the wave number (1/m)."""
        swing = math.sin(self._rate * (t_ns * 1e-9) + self._phase)
        return self._north_mps * swing, self._east_mps * swing, self._rate**2 / GRAVITY_MPS2
