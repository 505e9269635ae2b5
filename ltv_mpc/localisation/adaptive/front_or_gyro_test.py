"""Test whether an apparent front continues, and whether a front or a gyro fault explains it better.

While the process noise of the water is inflated (``process_noise.py``), its corrections follow the beams: they show how
the current seen by the ADCP departs from the IMU's prediction. D(t) is their sum since the inflation started, averaged
over the grid points that a ping sees (m/s, north and east).
    drifting    |slope of D over the last ``SLOPE_S``| > ``MIN_SLOPE_SD`` g sd(level)
                A level error makes a part of gravity look like an acceleration.
    front       D = c + s (t - t0) for t > t0                  linear in time
    gyro fault  D = c + g V(t - t0) b                          quadratic in time: V is the double integral of the body
                axes x and y since t0, so V b is the velocity from the tilt that a gyro bias b causes
The hypothesis with the smaller least-squares residual over all t0 wins.
"""

from __future__ import annotations

import math

import numpy as np

from ltv_mpc.frames import GRAVITY_MPS2
from ltv_mpc.localisation.filter.state import Belief
from ltv_mpc.messages import Array

SLOPE_S = 5.0
"""Time over which the slope is taken (s)."""

MIN_SLOPE_SD = 2.0
"""Smallest slope of a drift, in standard deviations of the level error times gravity."""

_MIN_PINGS = 4
"""Smallest number of pings for a slope."""

_MIN_AGE_S = 4.0
"""Smallest age of an onset t0 that is tried (s)."""


class FrontOrGyroTest:
    """Sum of the current corrections since process noise was inflated, and the two tests on it."""

    def __init__(self) -> None:
        self._t_s: list[float] = []
        self._moved_mps: list[Array] = []  # D (2,)
        self._turned_s: list[Array] = []  # (2, 2) s, integral of the body axes x and y, north and east

    def add(self, belief: Belief, moved_mps: Array) -> None:
        """Add the correction of one ping.

        Parameters
        ----------
        belief : state estimate at the time of the ping; its attitude is integrated.
        moved_mps : (2,) mean correction of the current, north and east (m/s).
        """
        t_s = belief.t_ns * 1e-9
        if self._t_s:
            moved_mps = self._moved_mps[-1] + moved_mps
            turned_s = self._turned_s[-1] + belief.R[:2, :2] * (t_s - self._t_s[-1])
        else:
            turned_s = np.zeros((2, 2))
        self._t_s.append(t_s)
        self._moved_mps.append(moved_mps)
        self._turned_s.append(turned_s)

    @property
    def duration_s(self) -> float:
        """Time from the first to the last ping (s)."""
        return self._t_s[-1] - self._t_s[0]

    def is_drifting(self, level_sd_rad: float) -> bool:
        """Return True if the sum still drifts.

        Parameters
        ----------
        level_sd_rad : standard deviation of the level error (rad).
        """
        t = np.array(self._t_s)
        late = t > t[-1] - SLOPE_S
        t = t[late] - t[late].mean()
        if len(t) < _MIN_PINGS:
            return False
        slope = t @ np.array(self._moved_mps)[late] / (t @ t)
        return math.hypot(*slope) > MIN_SLOPE_SD * GRAVITY_MPS2 * level_sd_rad

    def is_gyro_fault(self) -> bool:
        """Return True if a gyro fault fits the sum better than a front does."""
        t, D, turned = np.array(self._t_s), np.array(self._moved_mps), np.array(self._turned_s)
        dt = np.diff(t, prepend=t[0])
        one, zero = np.ones_like(t), np.zeros_like(t)
        front = gyro = math.inf
        for t0 in np.arange(t[0], t[-1] - _MIN_AGE_S, 1.0):
            even = np.stack([one, np.maximum(t - t0, 0.0)], axis=1)
            front = min(front, _residual(even, D))
            first = int(np.searchsorted(t, t0))
            tilt = np.where((t >= t0)[:, None, None], turned - turned[first], 0.0)  # (T, 2, 2), of b
            v = GRAVITY_MPS2 * np.cumsum(tilt * dt[:, None, None], axis=0)
            # a tilt about north makes gravity appear along east, a tilt about east along south
            north = np.stack([one, zero, -v[:, 1, 0], -v[:, 1, 1]], axis=1)
            east = np.stack([zero, one, v[:, 0, 0], v[:, 0, 1]], axis=1)
            gyro = min(gyro, _residual(np.concatenate([north, east]), D.T.ravel()))
        return gyro < front


def _residual(A: Array, y: Array) -> float:
    """Return the least-squares residual min_x |y - A x|^2."""
    r = y - A @ np.linalg.lstsq(A, y, rcond=None)[0]
    return float((r * r).sum())
