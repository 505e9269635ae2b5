"""Roll and pitch of the true vehicle: narrow-band, seeded, smooth, a pure function of time.

    roll(t) = rms sqrt(2 / K) sum_k sin(2 pi f_k t + p_k),  pitch likewise with numbers of its own

One f_k (Hz) is drawn in each of K equal bands of 0.7 to 1.3 times 1 / period, p_k anywhere; so the mean square over a
long time is rms^2 for each seed. A sum of sines has derivatives of every order: increments of an IMU are consistent at
any rate. The motion is imposed: it neither drives nor feels the other degrees of freedom (the vehicle is stable in roll
and pitch; wave and propeller torques are not modelled).
"""

from __future__ import annotations

import math

import numpy as np

from ltv_mpc.jit import jit
from ltv_mpc.messages import Array, Pair
from sim.random_streams import Stream, generator

SINES = 16
BAND = (0.7, 1.3)
"""Of 1 / period."""


class Attitude:
    """True roll and pitch."""

    def __init__(self, rms_rad: float, period_s: float, seed: int) -> None:
        """``rms_rad`` for roll and for pitch, around ``period_s``."""
        draws = generator(seed, Stream.ATTITUDE)
        edges = np.linspace(*BAND, SINES + 1) / period_s
        frequency = draws.uniform(edges[:-1], edges[1:], (2, SINES))
        self.waves = np.stack([2.0 * math.pi * frequency, draws.uniform(0.0, 2.0 * math.pi, (2, SINES))])
        self.amplitude_rad = rms_rad * math.sqrt(2.0 / SINES)

    def at(self, t_ns: int) -> Pair:
        """Roll and pitch (rad)."""
        return sum_of_sines(t_ns * 1e-9, self.amplitude_rad, self.waves)


@jit
def sum_of_sines(t: float, amplitude: float, waves: Array) -> Pair:
    """Both sums at t; ``waves`` (2, 2, K) holds angular frequency and phase of roll and of pitch."""
    roll = 0.0
    pitch = 0.0
    for k in range(waves.shape[2]):
        roll += math.sin(waves[0, 0, k] * t + waves[1, 0, k])
        pitch += math.sin(waves[0, 1, k] * t + waves[1, 1, k])
    return amplitude * roll, amplitude * pitch
