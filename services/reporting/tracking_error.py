"""Distance of the vehicle from the reference of a simulated run in progress.

It counts from the start of the descent, as in summary.json: a satellite fix is metres off, and the reference starts
at the estimated position. Before that start it is None.
"""

from __future__ import annotations

import math

from ltv_mpc.messages import Estimate, Pair, Truth
from services.supervisor.screen import LiveView


class TrackingError:
    """Horizontal error of the vehicle since the start: ``true_error_m``."""

    def __init__(self) -> None:
        self._at_start: Pair | None = None
        self.true_error_m: float | None = None

    def update(self, view: LiveView) -> None:
        """Update the error from a view of the run."""
        if view.truth is None or view.estimate is None or view.estimate.t_ns < 0:  # a fix may still move it by metres
            return
        if self._at_start is None:
            self._at_start = _difference(view.truth, view.estimate)
        north0, east0 = self._at_start
        if view.plan is not None and view.plan.reference_m is not None:
            north_ref, east_ref = view.plan.reference_m
            position = view.truth.position_m
            self.true_error_m = math.hypot(position[0] + north0 - north_ref, position[1] + east0 - east_ref)


def _difference(truth: Truth, estimate: Estimate) -> Pair:
    """Return estimate minus truth (m), the truth moved to the time of the estimate: at 0.2 m/s, 0.1 s is 2 cm."""
    later_s = (truth.t_ns - estimate.t_ns) * 1e-9
    return (
        estimate.north_m - (truth.position_m[0] - later_s * truth.velocity_mps[0]),
        estimate.east_m - (truth.position_m[1] - later_s * truth.velocity_mps[1]),
    )
