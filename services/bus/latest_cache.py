"""The newest frame of each key, for who looks now and then: nothing is decoded until then."""

from __future__ import annotations

import time
from collections.abc import ItemsView
from typing import NamedTuple

from services.bus.topics import Topic


class LatestFrame(NamedTuple):
    """A frame as it came."""

    topic: Topic
    payload: bytes
    arrived_s: float  # monotonic


class LatestCache:
    """Takes frames as a ``Mailbox`` does, and keeps the newest of each key."""

    def __init__(self) -> None:
        self._frames: dict[str, LatestFrame] = {}
        self.arrived_s = 0.0
        """When the newest of all came."""

    def offer(self, topic: Topic | None, key: str, payload: bytes) -> None:
        """Replace; called on Zenoh's thread."""
        if topic is not None:
            self.arrived_s = time.monotonic()
            self._frames[key] = LatestFrame(topic, payload, self.arrived_s)

    def get(self, key: str) -> LatestFrame | None:
        """What came last on a key."""
        return self._frames.get(key)

    def items(self) -> ItemsView[str, LatestFrame]:
        """Of every key, as it is now."""
        return self._frames.copy().items()
