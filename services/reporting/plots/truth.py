"""True track as plotted: from t = 0; where the reference begins at the vehicle, shifted to start at the estimate.

With truth p(t) and estimate e(t), the plotted error is (e(t) - e(0)) - (p(t) - p(0)), as in summary.json: a satellite
fix is metres off, and later errors are drift from there.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import deque

import numpy as np

from ltv_mpc.messages import Array, Estimate, Pair, Truth

PERIOD_NS = 100_000_000
ELLIPSE = 48  # points
MAX_TRUTHS = 600  # truths that wait for their estimate: one minute at 10 Hz


class TrueTrack:
    """Buffer of the newest true states, with the estimation error at the start."""

    def __init__(self) -> None:
        self.in_places = False  # the reference is given in places: nothing is shifted
        self.start_error: Pair | None = None  # estimate minus truth
        self.start_ns = 0  # time of the start error
        self._start_covariance: Array | None = None
        self._truths: deque[Truth] = deque(maxlen=MAX_TRUTHS)

    @property
    def known(self) -> bool:
        """True if a true state was received, as in a simulation."""
        return bool(self._truths)

    def add(self, truth: Truth) -> bool:
        """Add a true state and return True, or ignore it if the last one is less than ``PERIOD_NS`` old."""
        if self._truths and 0 <= truth.t_ns - self._truths[-1].t_ns < PERIOD_NS:
            return False
        if self._truths and truth.t_ns < self._truths[-1].t_ns:  # another run on the same keys
            self._truths.clear()
            self.start_error = self._start_covariance = None
        self._truths.append(truth)
        return True

    def begin(self, estimate: Estimate) -> list[Truth]:
        """Store the start error at the first estimate with t >= 0; return the true states since then, else []."""
        if self.start_error is not None or not self._truths or estimate.t_ns < 0:
            return []
        self.start_error, self.start_ns = self._difference(estimate), estimate.t_ns
        self._start_covariance = estimate.covariance
        return [truth for truth in self._truths if truth.t_ns >= estimate.t_ns]

    def position(self, truth: Truth) -> Pair | None:
        """Return north, east (m) of a true state as plotted; None before the start."""
        if self.start_error is None:
            return None
        north_m, east_m = (0.0, 0.0) if self.in_places else self.start_error
        return truth.position_m[0] + north_m, truth.position_m[1] + east_m

    def error(self, estimate: Estimate) -> Pair | None:
        """Return north, east (m) of the drift of the estimate since the start; None before it."""
        if self.start_error is None or not self._truths:
            return None
        north, east = self._difference(estimate)
        return north - self.start_error[0], east - self.start_error[1]

    def covariance(self, estimate: Estimate, *, absolute: bool = False) -> Array | None:
        """Return the position covariance (2, 2) (m^2); after the start that of the drift, P(t) - P(0), if not absolute.

        The error of the fix at the start is common to both times and cancels in the drift.
        """
        if estimate.covariance is None:
            return None
        position: Array = estimate.covariance[:2, :2]
        if self._start_covariance is not None and not absolute:
            position = position - self._start_covariance[:2, :2]
        return position

    def _difference(self, estimate: Estimate) -> Pair:
        """Return estimate minus truth (m), the nearest true state moved to the time of the estimate."""
        times = [truth.t_ns for truth in self._truths]
        i = bisect_left(times, estimate.t_ns)
        near = [self._truths[k] for k in (i - 1, i) if 0 <= k < len(times)]
        truth = min(near, key=lambda one: abs(one.t_ns - estimate.t_ns))
        later_s = (estimate.t_ns - truth.t_ns) * 1e-9
        return (
            estimate.north_m - truth.position_m[0] - later_s * truth.velocity_mps[0],
            estimate.east_m - truth.position_m[1] - later_s * truth.velocity_mps[1],
        )


def principal(covariance: Array) -> tuple[Array, Array]:
    """Return standard deviations (2,) along the principal axes, clipped at 0, and the axes as columns (2, 2)."""
    values, axes = np.linalg.eigh(covariance)
    return np.sqrt(values.clip(0.0)), axes


def outline(covariance: Array, sigmas: float) -> Array:
    """Return the ellipse (K, 2) of so many standard deviations round the mean of a distribution in the plane."""
    sigma, axes = principal(covariance)
    angle = np.linspace(0.0, 2.0 * np.pi, ELLIPSE + 1)
    points: Array = sigmas * axes @ (sigma[:, None] * np.array([np.cos(angle), np.sin(angle)]))
    return points.T
