"""Water prior of a run, and the current that a run has estimated, which can be the prior of a later one."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np

from ltv_mpc.currents import WaterPrior, read_prior
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.messages import Estimate, Message
from ltv_mpc.validation import rejection_reason


def resolve_prior_path(folder: Path, settings: EstimatorConfig) -> EstimatorConfig:
    """Return settings from a file of ``folder``, with the path of their water prior taken relative to that folder."""
    name = settings.water_prior
    return msgspec.structs.replace(settings, water_prior=str(folder / name) if name else "")


def load_prior(settings: EstimatorConfig) -> WaterPrior | None:
    """Return the water prior that the settings name, or None. Raises ``ConfigError``."""
    return read_prior(settings.water_prior) if settings.water_prior else None


class EstimatedCurrent:
    """Current over all depths, collected from the estimates of a run in their order.

    The profile of an estimator other than this project's may move with the vehicle. For a depth that has left it the
    last estimate counts. The error that all depths share is not part of an estimate. But the vehicle measures the
    water relative to itself, so the error of its velocity is in every cell that it sees, and has been since the last
    satellite fix. So sd_common is the standard deviation of the velocity, the larger one of north and east. It is at
    most the smallest standard deviation of a cell, of which it is a part.
    """

    def __init__(self) -> None:
        self._last: Estimate | None = None
        self._left: dict[float, tuple[float, float, float]] = {}  # depth: north, east, sd

    def update(self, estimate: Message) -> None:
        """Add the next estimate; other messages are ignored."""
        if not isinstance(estimate, Estimate):
            return
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
        """Return the current as a prior for a later run; depths not seen keep their assumed standard deviation.

        None if there is no estimate, a perfect one, or one without covariances.
        """
        last = self._last
        if last is None or last.current is None or rejection_reason(last) is not None:
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
