"""Which numbers of a sensor's last messages were made wild: whoever judges a filter leaves them out."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Mask = npt.NDArray[np.bool_]

KEPT = 1024
"""Messages that are remembered: all that can be on their way at the shortest period and the longest latency."""


class OutlierMasks:
    """Masks of outliers by the validity time of their message, which may arrive after later ones are taken."""

    def __init__(self) -> None:
        self._masks: dict[int, Mask] = {}

    def put(self, t_ns: int, mask: Mask) -> None:
        """Of the message of ``t_ns``; the shape is that of its measurements."""
        self._masks[t_ns] = mask
        if len(self._masks) > KEPT:
            del self._masks[next(iter(self._masks))]

    def at(self, t_ns: int) -> Mask | None:
        """The mask, or None where there was no such message or it is long ago."""
        return self._masks.get(t_ns)
