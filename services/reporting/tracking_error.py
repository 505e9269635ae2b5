"""Tracking error and localisation error of a run in progress.

Both count from the start of the descent, as in summary.json: a satellite fix is metres off, and the reference starts
at the estimated position. Before that start both are None.
"""

from __future__ import annotations

import math

from ltv_mpc.messages import Estimate, Pair, Truth
from services.supervisor.screen import LiveView


class TrackingError:
    """Horizontal errors since the start: ``true_error_m`` from the reference, ``localisation_m`` of the estimate."""

    def __init__(self) -> None:
        self._at_start: Pair | None = None
        self.true_error_m: float | None = None
        self.localisation_m: float | None = None

    def update(self, view: LiveView) -> None:
        """Update both errors from a view of the run."""
        if view.truth is None or view.estimate is None or view.estimate.t_ns < 0:  # a fix may still move it by metres
            return
        north, east = _difference(view.truth, view.estimate)
        if self._at_start is None:
            self._at_start = north, east
        north0, east0 = self._at_start
        self.localisation_m = math.hypot(north - north0, east - east0)
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
