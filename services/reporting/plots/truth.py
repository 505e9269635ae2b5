"""Where the vehicle really is, as plots show it: from t = 0, moved to where it then believed to be.

With p(t) the truth and e(t) the estimate the error shown is (e(t) - e(0)) - (p(t) - p(0)), as in summary.json: a
satellite fix is metres off, and everything after it is drift from there.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import deque

import numpy as np

from ltv_mpc.messages import Array, Estimate, Pair, Truth

PERIOD_NS = 100_000_000
MAX_TRUTHS = 600  # truths that wait for their estimate: a minute of them


class TrueTrack:
    """Remembers the newest truths, and the error at the start."""

    def __init__(self) -> None:
        self.start_error: Pair | None = None  # estimate minus truth
        self._start_covariance: Array | None = None
        self._truths: deque[Truth] = deque(maxlen=MAX_TRUTHS)

    @property
    def known(self) -> bool:
        """Whether anybody says the truth."""
        return bool(self._truths)

    def add(self, truth: Truth) -> bool:
        """Whether it is kept: ten a second are enough."""
        if self._truths and 0 <= truth.t_ns - self._truths[-1].t_ns < PERIOD_NS:
            return False
        if self._truths and truth.t_ns < self._truths[-1].t_ns:  # another run on the same keys
            self._truths.clear()
            self.start_error = self._start_covariance = None
        self._truths.append(truth)
        return True

    def begin(self, estimate: Estimate) -> list[Truth]:
        """Start with this estimate, if its time has come and nothing was started: the truths from then on."""
        if self.start_error is not None or not self._truths or estimate.t_ns < 0:
            return []
        self.start_error = self._difference(estimate)
        self._start_covariance = estimate.covariance
        return [truth for truth in self._truths if truth.t_ns >= estimate.t_ns]

    def position(self, truth: Truth) -> Pair | None:
        """North, east (m) of a truth as it is shown; None before the start."""
        if self.start_error is None:
            return None
        return truth.position_m[0] + self.start_error[0], truth.position_m[1] + self.start_error[1]

    def error(self, estimate: Estimate) -> Pair | None:
        """North, east (m) of the estimate's drift since the start; None before it."""
        if self.start_error is None or not self._truths:
            return None
        north, east = self._difference(estimate)
        return north - self.start_error[0], east - self.start_error[1]

    def covariance(self, estimate: Estimate) -> Array | None:
        """(2, 2) of the position (m^2); of its drift since the start where that is known.

        What the fix at the start was off by is common to both ends: P(t) - P(0).
        """
        if estimate.covariance is None:
            return None
        position: Array = estimate.covariance[:2, :2]
        if self._start_covariance is not None:
            position = position - self._start_covariance[:2, :2]
        return position

    def _difference(self, estimate: Estimate) -> Pair:
        """Estimate minus truth, of the truth that is nearest in time and moved to that of the estimate."""
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
    """Standard deviations (2,) along the principal axes, and these as columns (2, 2); none below zero."""
    values, axes = np.linalg.eigh(covariance)
    return np.sqrt(values.clip(0.0)), axes
