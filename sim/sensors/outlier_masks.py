"""Record of the measurements that are simulated outliers, so that an evaluation of the filter can leave them out."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

Mask = npt.NDArray[np.bool_]

MAX_MASKS = 1024
"""More than the messages that can be under way at the shortest period and the longest latency."""


class OutlierMasks:
    """Masks of outliers by the validity time of their message, which may arrive after later ones are taken."""

    def __init__(self) -> None:
        self._masks: dict[int, Mask] = {}

    def put(self, t_ns: int, mask: Mask) -> None:
        """Store the mask of the message of ``t_ns``; its shape is that of the measurements."""
        self._masks[t_ns] = mask
        if len(self._masks) > MAX_MASKS:
            del self._masks[next(iter(self._masks))]

    def at(self, t_ns: int) -> Mask | None:
        """Return the mask of the message of ``t_ns``; None if there was no such message or it is too old."""
        return self._masks.get(t_ns)


@runtime_checkable
class HasOutliers(Protocol):
    """A simulated sensor that has outliers."""

    outlier_masks: OutlierMasks
