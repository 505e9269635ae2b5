"""Roll and pitch of the true vehicle: a seeded, narrow-band, smooth function of time.

    roll(t) = rms sqrt(2 / K) sum_k sin(2 pi f_k t + p_k),  pitch likewise with its own frequencies and phases

The band from 0.7 to 1.3 times 1 / period is divided into K equal parts. One frequency f_k (Hz) is drawn in each part
and each phase p_k is uniform, so the mean square over a long time is rms^2 for every seed. A sum of sines has
derivatives of every order, so the increments of an IMU are consistent at any sampling rate. The motion is prescribed:
it neither affects nor depends on the other degrees of freedom (the vehicle is stable in roll and pitch; torques of
waves and propellers are not modelled).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ltv_mpc.jit import jit
from ltv_mpc.messages import Array, Pair
from sim.random_streams import Stream, generator

SINES = 16
BAND = (0.7, 1.3)
"""Limits of the frequency band, as multiples of 1 / period."""


class TiltWaves(NamedTuple):
    """Sums of sines that make up roll and pitch, for compiled code."""

    amplitude_rad: float  # of each sine
    waves: Array  # (2, 2, K): angular frequency (rad/s) and phase (rad) of roll and of pitch


class Attitude:
    """True roll and pitch of one run."""

    def __init__(self, rms_rad: float, period_s: float, seed: int) -> None:
        """Draw the sines; ``rms_rad`` and the mean period ``period_s`` hold for roll and for pitch."""
        draws = generator(seed, Stream.ATTITUDE)
        edges = np.linspace(*BAND, SINES + 1) / period_s
        frequency = draws.uniform(edges[:-1], edges[1:], (2, SINES))
        waves = np.stack([2.0 * math.pi * frequency, draws.uniform(0.0, 2.0 * math.pi, (2, SINES))])
        self.tilt = TiltWaves(rms_rad * math.sqrt(2.0 / SINES), waves)

    def at(self, t_ns: int) -> Pair:
        """Return roll and pitch (rad) at vehicle time ``t_ns``."""
        return roll_and_pitch(t_ns * 1e-9, self.tilt)


@jit
def roll_and_pitch(t: float, tilt: TiltWaves) -> Pair:
    """Return roll and pitch (rad) at vehicle time ``t`` (s)."""
    waves = tilt.waves
    roll = 0.0
    pitch = 0.0
    for k in range(waves.shape[2]):
        roll += math.sin(waves[0, 0, k] * t + waves[1, 0, k])
        pitch += math.sin(waves[0, 1, k] * t + waves[1, 1, k])
    return tilt.amplitude_rad * roll, tilt.amplitude_rad * pitch
