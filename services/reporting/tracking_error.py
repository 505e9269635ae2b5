"""How far the vehicle is from its line, and from where it believes to be, while a run goes on.

Both are drifts since the start of the descent, as in summary.json: a satellite fix is metres off, and the line starts
where the vehicle believed to be. Until then nothing is known of them.
"""

from __future__ import annotations

import math

from ltv_mpc.messages import Estimate, Pair, Truth
from services.supervisor.screen import LiveView


class TrackingError:
    """Remembers the error at the start."""

    def __init__(self) -> None:
        self._at_start: Pair | None = None
        self.true_error_m: float | None = None
        self.localisation_m: float | None = None

    def update(self, view: LiveView) -> None:
        """Look at this moment."""
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
    """Estimate minus truth, the truth brought to the estimate's time: at 0.2 m/s a tenth of a second is 2 cm."""
    later_s = (truth.t_ns - estimate.t_ns) * 1e-9
    return (
        estimate.north_m - (truth.position_m[0] - later_s * truth.velocity_mps[0]),
        estimate.east_m - (truth.position_m[1] - later_s * truth.velocity_mps[1]),
    )
