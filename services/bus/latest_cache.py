"""Cache of the newest frame of each key, for occasional readers: a frame is decoded only when it is read."""

from __future__ import annotations

import time
from collections.abc import ItemsView
from typing import NamedTuple

from services.bus.topics import Topic


class LatestFrame(NamedTuple):
    """Received frame, not decoded yet."""

    topic: Topic
    payload: bytes
    arrived_s: float  # monotonic


class LatestCache:
    """Receiver of frames, as a ``Mailbox``, that keeps the newest one of each key."""

    def __init__(self) -> None:
        self._frames: dict[str, LatestFrame] = {}
        self.arrived_s = 0.0
        """Arrival of the newest frame of all (monotonic, s)."""

    def offer(self, topic: Topic | None, key: str, payload: bytes) -> None:
        """Replace the frame of a key; called on Zenoh's thread."""
        if topic is not None:
            self.arrived_s = time.monotonic()
            self._frames[key] = LatestFrame(topic, payload, self.arrived_s)

    def get(self, key: str) -> LatestFrame | None:
        """Return the newest frame of a key, or None."""
        return self._frames.get(key)

    def items(self) -> ItemsView[str, LatestFrame]:
        """Return the newest frames of all keys, as a copy."""
        return self._frames.copy().items()
