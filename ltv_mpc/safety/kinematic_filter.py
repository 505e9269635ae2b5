"""Kinematic filter: a value that is noisy is filtered with its rate, and a rate that is not the value's is derived.

A bare receiver gives positions with white noise, and the controller would follow the noise. A velocity that nobody
filled in, one along the vehicle's axes, in knots or through the water, a yaw rate in degrees or of the other sign:
whatever the slip, the vehicle is steered by how it moves. For the last ``WINDOW`` changes of a value x with rate w and
standard deviations s (0 if not given),

    i_k = x_k - x_(k-1) - integral of w                    what the value changed beyond its rate
    n   = sqrt(sum of |i_k - i_(k-1)|^2 / (6 number))      noise of the value, if it is white; steps and stairs are more
    the rate fails if |sum of i| is above  ``SHARE`` of the largest rate x time,  10 n,  and  5 (s_x + s_w x time)

Without s, the value is noisy by R, if that is above what is clean:

    R = (1.48 median |i_k|)^2 / 2                          a single step, a fix after a drift, is not in the median

A Kalman filter then gives x: with R, from the given rate and a small random walk of x; with n^2 at most, from a rate
that it estimates and that walks as far as thrust can change it, from a failure until the given rate has agreed with the
motion for ``AGREED`` changes. What is neither noisy nor failed is used as it is; a value that is repeated, as a slow
receiver's is, moves on by its rate.
Source: Bar-Shalom, Li & Kirubarajan 2001, Estimation with applications to tracking and navigation, section 6.2.2.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from ltv_mpc.messages import Array, Pair

WINDOW, LEAST = 15, 8
"""Number of changes that are compared, and from which they are."""

SPACING_S, MAX_INTERVAL_S = 0.2, 2.0
"""Least time from one change to the next, and longest time between two estimates over which rates are linear."""

SHARE, NOISES, SIGMAS = 0.1, 10.0, 5.0
"""Least error of a rate that fails, over the largest rate; and multiples of the noise, and of the given standard
deviations. A single step of a position is at most 9.2 n.
"""

STANDS_S = 3.0
"""Time from which a value that is repeated stands still, if its rate has moved it by a second of its largest."""

AGREED = 300
"""Changes in motion with which a failed rate agrees until it is used again."""

RESOLUTION_S = 0.002
"""Least noise of a value over its largest rate."""

VALUE_WALK, AGILITY = 0.02, 0.3
"""Walks in a second: of a value beyond the integral of a rate that is believed (m, or rad), and of an estimated rate
over the acceleration at full thrust.
"""

OF_MEDIAN = 1.4826
"""Standard deviation over the median of the absolute value, of a normal distribution."""


class KinematicFilter:
    """Filter of a value and its rate, where one of them needs it."""

    def __init__(self, largest: float, acceleration: float, clean: float = math.inf) -> None:
        """Begin with a value and a rate that are used as they are.

        Parameters
        ----------
        largest : rate at full thrust (m/s, or rad/s).
        acceleration : at full thrust, from rest (m/s^2, or rad/s^2).
        clean : noise of the value up to which it is used as it is (m, or rad).
        """
        self.failed = False
        """True while the rate is derived."""
        self.stands = False
        """True while the value is repeated although its rate has moved it far."""
        self._largest, self._rate_walk, self._clean = largest, AGILITY * acceleration, clean
        self._last: tuple[int, Array] | None = None  # time (ns) and rate of the last estimate
        self._changes: deque[tuple[float, Array, Array]] = deque(maxlen=WINDOW)  # time (s), change of the value, i
        self._since, self._way, self._seconds = np.empty(0), np.empty(0), 0.0  # last change: value; way, time since it
        self._agreed = 0
        self._x: Array | None = None  # filtered value; None: as it is given
        self._w, self._P = np.empty(0), np.zeros((2, 2))

    def update(self, t_ns: int, x: Array, w: Array, sd: Pair) -> tuple[Array, Array]:
        """Add an estimate. Return the value and the rate to use.

        Parameters
        ----------
        t_ns : vehicle time (ns).
        x, w : (n,) value, unwrapped if it is an angle, and its rate.
        sd : standard deviations of value and rate; 0 if not given.
        """
        if self._last is None or t_ns < self._last[0]:  # the clock was set back
            self.failed, self._last = False, None
        last_ns, w_before = (t_ns, w) if self._last is None else self._last
        seconds, way = (t_ns - last_ns) * 1e-9, 0.5e-9 * (t_ns - last_ns) * (w_before + w)
        if self._last is None or seconds > MAX_INTERVAL_S:
            self._changes.clear()
            self._since, self._way, self._seconds = x, np.zeros_like(x), 0.0
            self._x = self._x if self.failed else None
        else:
            self._way, self._seconds = self._way + way, self._seconds + seconds
        self._last, self._w = (t_ns, w), self._w if self.failed else w
        if self._x is not None:
            self._predict(self._x, seconds, way)
        changed = x - self._since
        if self._seconds >= SPACING_S and changed.any():
            self._changes.append((self._seconds, changed, changed - self._way))
            self._since, self._way, self._seconds = x, np.zeros_like(x), 0.0
            if len(self._changes) >= LEAST:
                self._judge(x, sd)
        elif not changed.any() and self._way.any():  # repeated: moved on by its rate
            x = x + self._way
        self.stands = self._seconds > STANDS_S and _size(self._way) > self._largest
        return x if self._x is None else self._x, self._w if self.failed else w

    def _judge(self, x: Array, sd: Pair) -> None:
        """Compare value and rate over the window; begin, correct or end the filter."""
        times, changes, i = (np.array(column) for column in zip(*self._changes, strict=True))
        seconds, moved = float(times.sum()), changes.sum(axis=0)
        n = math.sqrt(float(np.square(np.diff(i, axis=0)).sum()) / (6.0 * (len(i) - 1)))
        least, beyond = SHARE * self._largest * seconds, _size(i.sum(axis=0))
        if beyond > max(least, NOISES * n, SIGMAS * (sd[0] + sd[1] * seconds)):
            if not self.failed:
                self._x, self._w, self._P = None, moved / seconds, np.diag([0.0, self._largest**2])
            self.failed, self._agreed = True, 0
        elif _size(moved) > least:
            self._agreed += 1
            self.failed = self.failed and self._agreed < AGREED
        if self.failed:
            bends = np.diff(changes, n=2, axis=0)  # noise without the rate, which may vary wildly
            noise = max(
                min(n, math.sqrt(float(np.square(bends).sum()) / (20.0 * len(bends)))), RESOLUTION_S * self._largest
            )
        else:
            noise = OF_MEDIAN * math.sqrt(0.5) * _median(np.abs(i))
            if sd[0] > 0.0 or noise <= self._clean:
                self._x = None
                return
        if self._x is None:
            self._x, self._P[0] = x, (noise**2, 0.0)
        else:
            self._correct(x - self._x, noise**2)

    def _predict(self, x: Array, seconds: float, way: Array) -> None:
        if self.failed:
            self._x = x + seconds * self._w
            F, walk2 = np.array([[1.0, seconds], [0.0, 1.0]]), self._rate_walk**2
            Q = walk2 * np.array([[seconds**3 / 3.0, seconds**2 / 2.0], [seconds**2 / 2.0, seconds]])
            self._P = F @ self._P @ F.T + Q
        else:
            self._x, self._P = x + way, np.diag([self._P[0, 0] + VALUE_WALK**2 * seconds, 0.0])

    def _correct(self, innovation: Array, variance: float) -> None:
        gain = self._P[:, 0] / (self._P[0, 0] + variance)
        self._x, self._w = self._x + gain[0] * innovation, self._w + gain[1] * innovation
        self._P = self._P - np.outer(gain, self._P[0])


def _size(vector: Array) -> float:
    return math.sqrt(float(vector @ vector))


def _median(values: Array) -> float:
    """Return the upper median; numpy's takes ten times as long."""
    return float(np.sort(values, axis=None)[values.size // 2])
