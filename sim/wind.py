"""Wind: a steady force on the vehicle in the earth frame, and gusts along it.

    f(t) = [cos direction, sin direction] (force + gust sqrt(2 / K) sum_k sin(2 pi f_k t + p_k))

The K frequencies f_k (Hz) lie at equal ratios over two decades about 1 / period, each with the same share of the mean
square, and the phases p_k are uniform: f S(f) is flat, as in the middle of the spectra of gusts (Fossen 2021, section
10.1). It is a pure function of seed and time. No wind acts below the surface, and none turns the vehicle.
"""

from __future__ import annotations

import math

import numpy as np

from ltv_mpc.messages import Pair
from sim.random_streams import Stream, generator
from sim.scenario import SURFACED_M
from sim.scenario import Wind as Settings

SINES = 16


class Wind:
    """Force of the wind in one run, from the settings' table [plant.wind]."""

    def __init__(self, settings: Settings, seed: int) -> None:
        """Take the settings and draw the phases of the gusts."""
        self.blows = max(settings.force_N, settings.gust_N) > 0.0
        self._settings = settings
        self._rates = 2.0 * math.pi / settings.gust_period_s * np.geomspace(0.1, 10.0, SINES)
        self._phases = generator(seed, Stream.WIND).uniform(0.0, 2.0 * math.pi, SINES)

    def force_N(self, t_ns: int, depth_m: float) -> Pair:
        """Return the force north and east at a time and a depth."""
        if not self.blows or depth_m >= SURFACED_M:
            return 0.0, 0.0
        gust = math.sqrt(2.0 / SINES) * float(np.sin(self._rates * (t_ns * 1e-9) + self._phases).sum())
        force = self._settings.force_N + self._settings.gust_N * gust
        return force * math.cos(self._settings.direction_rad), force * math.sin(self._settings.direction_rad)
