"""Does what was taken for a front still go on, and is it a front? Asked of where the water has gone since.

While the water is granted a walk that is wider than anything the vehicle does (``process_noise.py``), its corrections
follow the beams, and so say by how much water and inertial unit part. Of their sum D(t), of all nodes that a ping sees:
    goes on   its slope over the last ``SLOPE_S`` is beyond what the level's error makes of gravity, ``TIMES`` its sd
    a front   D = c + s (t - t0) for t > t0          grows evenly
    a gyro    D = c + g v(t - t0) b                  grows as the square: v is the integral of the tilt that a bias b of
              the gyros about the body's x and y has made since t0, the body's own turning with it
whichever leaves less, by least squares over t0.
"""

from __future__ import annotations

import math

import numpy as np

from ltv_mpc.frames import GRAVITY_MPS2
from ltv_mpc.localisation.filter.state import Belief
from ltv_mpc.messages import Array

SLOPE_S = 5.0
MIN_SLOPE_SD = 2.0
_FEWEST = 4
_SETTLED_S = 4.0
"""A beginning later than this before now is not asked of."""


class FrontOrGyroTest:
    """Of all water, since a walk was granted."""

    def __init__(self) -> None:
        self._t_s: list[float] = []
        self._moved_mps: list[Array] = []  # D (2,)
        self._turned_s: list[Array] = []  # (2, 2), integral of the body's x and y axes, north and east

    def copy(self) -> FrontOrGyroTest:
        """Independent of this one."""
        other = FrontOrGyroTest()
        other._t_s, other._moved_mps = list(self._t_s), list(self._moved_mps)
        other._turned_s = list(self._turned_s)
        return other

    def add(self, belief: Belief, moved_mps: Array) -> None:
        """One ping has moved the water by (2,), north and east."""
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
        """Since the first ping."""
        return self._t_s[-1] - self._t_s[0]

    def is_drifting(self, level_sd_rad: float) -> bool:
        """Whether it drifts still, ``level_sd_rad`` being by how much the level may be wrong."""
        t = np.array(self._t_s)
        late = t > t[-1] - SLOPE_S
        t = t[late] - t[late].mean()
        if len(t) < _FEWEST:
            return False
        slope = t @ np.array(self._moved_mps)[late] / (t @ t)
        return math.hypot(*slope) > MIN_SLOPE_SD * GRAVITY_MPS2 * level_sd_rad

    def is_gyro_fault(self) -> bool:
        """Whether a gyro explains it better than water does."""
        t, D, turned = np.array(self._t_s), np.array(self._moved_mps), np.array(self._turned_s)
        dt = np.diff(t, prepend=t[0])
        one, zero = np.ones_like(t), np.zeros_like(t)
        front = gyro = math.inf
        for t0 in np.arange(t[0], t[-1] - _SETTLED_S, 1.0):
            even = np.stack([one, np.maximum(t - t0, 0.0)], axis=1)
            front = min(front, _left(even, D))
            first = int(np.searchsorted(t, t0))
            tilt = np.where((t >= t0)[:, None, None], turned - turned[first], 0.0)  # (T, 2, 2), of b
            v = GRAVITY_MPS2 * np.cumsum(tilt * dt[:, None, None], axis=0)
            # a tilt about north, to the east, has gravity pull along east, and one about east along south
            north = np.stack([one, zero, -v[:, 1, 0], -v[:, 1, 1]], axis=1)
            east = np.stack([zero, one, v[:, 0, 0], v[:, 0, 1]], axis=1)
            gyro = min(gyro, _left(np.concatenate([north, east]), D.T.ravel()))
        return gyro < front


def _left(A: Array, y: Array) -> float:
    """Sum of squares that no A x takes from y."""
    r = y - A @ np.linalg.lstsq(A, y, rcond=None)[0]
    return float((r * r).sum())
