"""What a run is told of the water before it, and what it has learned at its end."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np

from ltv_mpc.currents import WaterPrior, read_prior
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.messages import Estimate
from ltv_mpc.validation import refusal


def resolve_prior_path(folder: Path, settings: EstimatorConfig) -> EstimatorConfig:
    """Settings from a file of ``folder``: the file of the prior that they name is relative to it."""
    name = settings.water_prior
    return msgspec.structs.replace(settings, water_prior=str(folder / name) if name else "")


def load_prior(settings: EstimatorConfig) -> WaterPrior | None:
    """The prior that the settings name, None where they name none. Raises ``ConfigError``."""
    return read_prior(settings.water_prior) if settings.water_prior else None


class EstimatedCurrent:
    """What a run has come to know of the current, from its estimates in their order.

    An estimate's profile may be a window of depths that follows the vehicle: of a depth that it has left counts what
    was known last. What all depths share is not in an estimate. But the vehicle measures water against itself: its
    velocity's error is in every cell that it sees, and has been since it lost the satellites. So sd_common is the
    velocity's standard deviation, of north or east the larger one, and at most the smallest of the cells', of which
    it is a part.
    """

    def __init__(self) -> None:
        self._last: Estimate | None = None
        self._left: dict[float, tuple[float, float, float]] = {}  # depth: north, east, sd

    def update(self, estimate: Estimate) -> None:
        """The next estimate."""
        before = None if self._last is None else self._last.current
        now = estimate.current
        if before is not None and before.sd_mps is not None:
            there = () if now is None else now.depth_m
            if not np.array_equal(before.depth_m, there):
                for k in np.flatnonzero(~np.isin(before.depth_m, there)):
                    known = before.north_mps[k], before.east_mps[k], before.sd_mps[k]
                    self._left[float(before.depth_m[k])] = known
        self._last = estimate

    def prior(self) -> WaterPrior | None:
        """As a later run may be told it, all depths with their standard deviations, of unseen ones the assumed one.

        None where there is nothing to go by: no estimate, a perfect one, one without covariances.
        """
        last = self._last
        if last is None or last.current is None or refusal(last) is not None:
            return None
        current, covariance = last.current, last.covariance
        if current.sd_mps is None or covariance is None:
            return None
        rows = np.column_stack([current.north_mps, current.east_mps, current.sd_mps]).tolist()
        known = self._left | dict(zip(current.depth_m.tolist(), map(tuple, rows), strict=True))
        depth, values = np.array(sorted(known)), np.array([known[z] for z in sorted(known)])
        north, east, sd = values.T.copy()
        velocity_sd = float(np.sqrt(max(covariance[2, 2], covariance[3, 3])))
        common = min(velocity_sd, float(sd.min()))
        return WaterPrior(depth_m=depth, north_mps=north, east_mps=east, sd_mps=sd, sd_common_mps=common)
