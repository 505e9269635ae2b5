"""Wave filter: the part of an estimated velocity that is neither the vehicle's slow motion nor the model's error.

Waves carry a vehicle to and fro within seconds. This motion answers no thrust, is no current, and shows nothing of the
vehicle file. In each axis the innovation z of the velocity is that of three states and white noise:

    z = d + x' + noise of variance w             d       error of the slow velocity, d+ = d + noise (a^2 + n^2)
    x'' = -W^2 x - 2 D W x' + noise              x, x'   displacement (m) and velocity (m/s) by waves

x' has the variance s^2 without end. With s = w = 0 the slow velocity is the estimated one. Innovations of right s and w
are white, so both follow from their spectrum: w falls with the product of successive ones; s^2 rises with their power
in the band of waves beyond that below it, relative to white noise, as far as they go to both sides. A wrong model shows
below the band, in one direction, as a thruster that is suddenly weak, or is expected as long as the belief is
uncertain. s^2 falls where innovations are less than it predicts.

Sources: Fossen 2021, Handbook of marine craft hydrodynamics and motion control, section 13.2 (linear wave model); Mehra
1970, IEEE T-AC 15(2) (noise from the correlation of innovations).
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.jit import jit_outlined
from ltv_mpc.messages import Array

BAND_RADPS, DAMPING = 1.3, 0.4
"""W and D: periods of 3 to 8 s."""

FAST_S, SLOW_S = 0.5, 4.0
"""Time constants of two means of the innovations: the band is the difference, and below it is the slow mean."""

WHITE_SHARE, GROWING_SHARE, FALLING_SHARE, PEAK_SHARE = 0.03, 0.3, 0.05, 0.7
"""Shares of the newest products of innovations in w, and of their power, or lack of it, in s^2; and variance over the
square of the smaller peak of both sides: 0.5 for a sine, more for waves, whose peaks differ.
"""

WHITE, SQUARE, MOST, INNOVATION, FAST, SLOW, HIGH, LOW, MOVED, MOVING, DD, DX, DV, XX, XV, VV, NIS, SIZE = range(18)
"""Rows of a track (SIZE, 3), with a column for each of surge, sway and yaw: w; the last innovation, its two means, and
the largest of their difference to either side; x, x' (north, east, and 0 for yaw); covariance of d, x, x'. First in
their rows: s^2, its largest value, and the observer's normalised innovation squared (chi-squared of three if all is
right).
"""


@jit_outlined
def predict_noise(track: Array, seconds: float, r2: Array) -> None:
    """Predict the track over an interval, and add to r2 (3,), a^2 + n^2, what makes it the variance of z.

    Parameters
    ----------
    track : (SIZE, 3) is overwritten.
    seconds : length of the interval (s).
    r2 : (3,) is overwritten.
    """
    if not np.isfinite(r2.sum()):  # of an estimate that is ignored
        return
    rate = BAND_RADPS * np.sqrt(1.0 - DAMPING**2)
    decay = np.exp(-DAMPING * BAND_RADPS * seconds)
    c, s = decay * np.cos(rate * seconds), decay * np.sin(rate * seconds) / rate
    f11, f12, f21, f22 = c + DAMPING * BAND_RADPS * s, s, -(BAND_RADPS**2) * s, c - DAMPING * BAND_RADPS * s
    for i in range(3):
        lasting = track[SQUARE, 0] if i < 2 else 0.0
        x, v = track[MOVED, i], track[MOVING, i]
        track[MOVED, i], track[MOVING, i] = f11 * x + f12 * v, f21 * x + f22 * v
        track[DD, i] += r2[i]
        x, v = track[DX, i], track[DV, i]
        track[DX, i], track[DV, i] = f11 * x + f12 * v, f21 * x + f22 * v
        # P - P_0 decays, P_0 the covariance without end
        xx, xv, vv = track[XX, i] - lasting / BAND_RADPS**2, track[XV, i], track[VV, i] - lasting
        track[XX, i] = f11 * f11 * xx + 2.0 * f11 * f12 * xv + f12 * f12 * vv + lasting / BAND_RADPS**2
        track[XV, i] = f11 * f21 * xx + (f11 * f22 + f12 * f21) * xv + f12 * f22 * vv
        track[VV, i] = f21 * f21 * xx + 2.0 * f21 * f22 * xv + f22 * f22 * vv + lasting
        r2[i] = track[DD, i] + 2.0 * track[DV, i] + track[VV, i] + track[WHITE, i]


@jit_outlined
def correct_noise(track: Array, seconds: float, r2: Array, explained: Array, z: Array, cos: float, sin: float) -> None:
    """Correct the track with the innovations z (3,), which become what is to be taken from the velocity.

    Parameters
    ----------
    track : (SIZE, 3) is overwritten.
    seconds, r2 : as ``predict_noise`` takes and gives them.
    explained : (3,) variance of z by what the observer has not learned yet.
    z : (3,) in the axes of the body; is overwritten.
    cos, sin : of the heading.
    """
    fast, slow = seconds / (FAST_S + seconds), seconds / (SLOW_S + seconds)
    of_slow = slow / (2.0 - slow)  # variances of the means of white noise of variance 1
    of_band = fast / (2.0 - fast) + of_slow - 2.0 * fast * slow / (fast + slow - fast * slow)
    moved, moving, power, excess = np.empty(3), np.empty(3), 0.0, 0.0
    for i in range(3):
        d, x, v = track[DD, i] + track[DV, i], track[DX, i] + track[XV, i], track[DV, i] + track[VV, i]
        track[WHITE, i] = max(track[WHITE, i] - WHITE_SHARE * z[i] * track[INNOVATION, i], 0.0)
        track[INNOVATION, i] = z[i]
        track[FAST, i] += fast * (z[i] - track[FAST, i])
        track[SLOW, i] += slow * (z[i] - track[SLOW, i])
        if i < 2:
            band = track[FAST, i] - track[SLOW, i]
            track[HIGH, i] = max((1.0 - slow) * track[HIGH, i], band)
            track[LOW, i] = max((1.0 - slow) * track[LOW, i], -band)
            power += PEAK_SHARE * min(track[HIGH, i], track[LOW, i]) ** 2 / of_band
            power -= track[SLOW, i] ** 2 / of_slow + explained[i]
            excess += z[i] ** 2 - track[VV, i]
        moved[i], moving[i] = x / r2[i] * z[i], v / r2[i] * z[i]
        for row, by in ((DD, d * d), (DX, d * x), (DV, d * v), (XX, x * x), (XV, x * v), (VV, v * v)):
            track[row, i] -= by / r2[i]
        z[i] *= 1.0 - d / r2[i]
    track[SQUARE, 0] += GROWING_SHARE * max(power, 0.0) + FALLING_SHARE * min(excess, 0.0)
    track[SQUARE, 0] = max(track[SQUARE, 0], 0.0)
    z[0] += cos * track[MOVING, 0] + sin * track[MOVING, 1]
    z[1] += cos * track[MOVING, 1] - sin * track[MOVING, 0]
    for gain, row in ((moved, MOVED), (moving, MOVING)):
        track[row, 0] += cos * gain[0] - sin * gain[1]
        track[row, 1] += sin * gain[0] + cos * gain[1]
    track[MOST, 0] = max(track[SQUARE, 0], track[MOST, 0])
