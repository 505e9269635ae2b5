"""Rate check: velocities and yaw rates that are not those of the positions and headings are derived from these.

A velocity that nobody filled in, one along the vehicle's axes, in knots or through the water, a yaw rate in degrees or
of the other sign: whatever the slip, the vehicle is steered by how it moves. For the last ``WINDOW`` changes of a value
x with rate w and standard deviations s (0 if not given),

    i_k = x_k - x_(k-1) - integral of w                  what the value changed beyond its rate
    n   = sqrt(sum of |i_k - i_(k-1)|^2 / (6 number))    noise of the value, if it is white; steps and stairs are more
    the rate fails if |sum of i| is above  ``SHARE`` of the largest rate x time,  10 n,  and  5 (s_x + s_w x time)

Instead of a rate that has failed, that of a Kalman filter of x is used, with a rate that walks as far as thrust can
change it, until the given one has agreed with the motion for ``AGREED`` changes.
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

AGREED = 300
"""Changes in motion with which a failed rate agrees until it is used again."""

RESOLUTION_S = 0.002
"""Least noise of a value over its largest rate."""

AGILITY = 0.3
"""Walk of the rate in a second over the acceleration at full thrust."""


class RateCheck:
    """Check of one rate, and the filter that replaces it."""

    def __init__(self, largest: float, acceleration: float) -> None:
        """Begin with a rate that is believed.

        Parameters
        ----------
        largest : rate at full thrust (m/s, or rad/s).
        acceleration : at full thrust, from rest (m/s^2, or rad/s^2).
        """
        self.failed = False
        """True while the rate is derived."""
        self._largest, self._walk = largest, (AGILITY * acceleration) ** 2
        self._last: tuple[int, Array] | None = None  # time (ns) and rate of the last estimate
        self._changes: deque[tuple[float, Array, Array]] = deque(maxlen=WINDOW)  # time (s), change of the value, i
        self._agreed = 0
        self._since, self._way, self._seconds = (
            np.empty(0),
            np.empty(0),
            0.0,
        )  # last change: value; integral since, time
        self._x, self._w, self._P = np.empty(0), np.empty(0), np.empty((2, 2))

    def update(self, t_ns: int, x: Array, w: Array, sd: Pair) -> tuple[Array, Array] | None:
        """Add an estimate. Return value and rate of the filter; None while the given rate is believed.

        Parameters
        ----------
        t_ns : vehicle time (ns).
        x, w : (n,) value, unwrapped if it is an angle, and its rate.
        sd : standard deviations of value and rate; 0 if not given.
        """
        if self._last is None or t_ns < self._last[0]:  # the clock was set back
            self.failed, self._last = False, None
        last_ns, w_before = (t_ns, w) if self._last is None else self._last
        seconds = (t_ns - last_ns) * 1e-9
        if self._last is None or seconds > MAX_INTERVAL_S:
            self._changes.clear()
            self._since, self._way, self._seconds = x, np.zeros_like(x), 0.0
        else:
            self._way, self._seconds = self._way + 0.5 * seconds * (w_before + w), self._seconds + seconds
        if self.failed:
            self._predict(seconds)
        self._last = t_ns, w
        changed = x - self._since
        if self._seconds >= SPACING_S and changed.any():
            self._changes.append((self._seconds, changed, changed - self._way))
            self._since, self._way, self._seconds = x, np.zeros_like(x), 0.0
            if len(self._changes) >= LEAST:
                self._judge(x, sd)
        return (self._x, self._w) if self.failed else None

    def _judge(self, x: Array, sd: Pair) -> None:
        """Compare value and rate over the window; correct the filter."""
        times, changes, i = (np.array(column) for column in zip(*self._changes, strict=True))
        seconds, way = float(times.sum()), changes.sum(axis=0)
        noise = math.sqrt(float(np.square(np.diff(i, axis=0)).sum()) / (6.0 * (len(i) - 1)))
        least, beyond = SHARE * self._largest * seconds, float(np.hypot.reduce(i.sum(axis=0)))
        wrong = beyond > max(least, NOISES * noise, SIGMAS * (sd[0] + sd[1] * seconds))
        bends = np.diff(changes, n=2, axis=0)  # noise without the rate, which may vary wildly
        noise = max(
            min(noise, math.sqrt(float(np.square(bends).sum()) / (20.0 * len(bends)))), RESOLUTION_S * self._largest
        )
        if self.failed:
            self._correct(x, noise**2)
        elif wrong:
            self._x, self._w, self._P = x, way / seconds, np.diag([noise**2, self._largest**2])
        if wrong:
            self.failed, self._agreed = True, 0
        elif np.hypot.reduce(way) > least:
            self._agreed += 1
            self.failed = self.failed and self._agreed < AGREED

    def _predict(self, seconds: float) -> None:
        F = np.array([[1.0, seconds], [0.0, 1.0]])
        Q = np.array([[seconds**3 / 3.0, seconds**2 / 2.0], [seconds**2 / 2.0, seconds]])
        self._x, self._P = self._x + seconds * self._w, F @ self._P @ F.T + self._walk * Q

    def _correct(self, x: Array, variance: float) -> None:
        gain, innovation = self._P[:, 0] / (self._P[0, 0] + variance), x - self._x
        self._x, self._w = self._x + gain[0] * innovation, self._w + gain[1] * innovation
        self._P = self._P - np.outer(gain, self._P[0])
