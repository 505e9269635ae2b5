"""Position filter: the position of noisy estimates without a covariance, from their velocity and their positions.

A navigation filter gives a position that is the integral of its velocity, up to small corrections. A bare receiver
gives positions with white noise, and the controller would follow the noise. With positions p and velocities v, for
each horizontal component,

    R = (1.48 median |p - p_before - v dt|)^2 / 2     over the last ``WINDOW`` estimates: variance of a position
    x <- x + v dt,   P <- P + q^2 dt
    K = P / (P + R),   x <- x + K (p - x),   P <- (1 - K) P

A single correction of the position, a fix after a drift, does not change the median. Up to a noise of ``CLEAN_M`` the
estimates are used as they are.
"""

from __future__ import annotations

import math
from collections import deque

import msgspec

from ltv_mpc.messages import Estimate, Pair

WINDOW = 15
"""Number of innovations in the median: a noise shows after 8 estimates."""

CLEAN_M = 0.03
"""Noise of the positions up to which they are used as they are."""

VELOCITY_ERROR_M_PER_RTS = 0.02
"""q: random walk of the integral of the velocities."""

MAX_INTERVAL_NS = 2_000_000_000
"""Longest time between two estimates: over a longer one the velocity is not constant enough, and the filter starts."""

OF_MEDIAN = 1.4826
"""Standard deviation over the median of the absolute value, of a normal distribution."""


class PositionFilter:
    """Kalman filter of the horizontal position, with the noise that the positions show."""

    def __init__(self) -> None:
        self._last: Estimate | None = None  # as it was given
        self._filtered: Pair | None = None  # None: as it was given
        self._variance = 0.0
        self._innovations: deque[float] = deque(maxlen=2 * WINDOW)  # both components of each

    def update(self, estimate: Estimate) -> Estimate:
        """Return the estimate with the filtered position; itself if its positions are clean, or have a covariance.

        Parameters
        ----------
        estimate : the newest accepted one.
        """
        last, self._last = self._last, estimate
        if last is not None and estimate.t_ns == last.t_ns:
            return self._with_position(estimate)
        if last is None or not 0 < estimate.t_ns - last.t_ns <= MAX_INTERVAL_NS or estimate.covariance is not None:
            self._filtered, self._variance = None, 0.0
            self._innovations.clear()
            return estimate
        seconds = (estimate.t_ns - last.t_ns) * 1e-9
        north_m = 0.5 * seconds * (last.velocity_north_mps + estimate.velocity_north_mps)
        east_m = 0.5 * seconds * (last.velocity_east_mps + estimate.velocity_east_mps)
        self._innovations.append(abs(estimate.north_m - last.north_m - north_m))
        self._innovations.append(abs(estimate.east_m - last.east_m - east_m))
        # the difference of two positions has twice the variance of one
        middle = sorted(self._innovations)[len(self._innovations) // 2]  # numpy's median takes ten times as long
        noise_m = OF_MEDIAN * math.sqrt(0.5) * middle
        if len(self._innovations) < WINDOW or noise_m <= CLEAN_M:
            self._filtered, self._variance = None, noise_m**2
            return estimate
        self._variance += VELOCITY_ERROR_M_PER_RTS**2 * seconds
        gain = self._variance / (self._variance + noise_m**2)
        before = self._filtered or (last.north_m, last.east_m)
        north_m, east_m = before[0] + north_m, before[1] + east_m  # predicted
        self._filtered = north_m + gain * (estimate.north_m - north_m), east_m + gain * (estimate.east_m - east_m)
        self._variance *= 1.0 - gain
        return self._with_position(estimate)

    def _with_position(self, estimate: Estimate) -> Estimate:
        if self._filtered is None:
            return estimate
        return msgspec.structs.replace(estimate, north_m=self._filtered[0], east_m=self._filtered[1])
