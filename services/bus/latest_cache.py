"""Cache of the newest frame of each key, for occasional readers: a frame is decoded only when it is read."""

from __future__ import annotations

import time
from functools import cached_property

from ltv_mpc.messages import Message
from services.bus.message_validation import valid_message
from services.bus.topics import Topic
from services.bus.wire import Header


class LatestFrame:
    """Received frame."""

    def __init__(self, topic: Topic, key: str, payload: bytes) -> None:
        self.topic, self.key, self.payload = topic, key, payload
        self.arrived_s = time.monotonic()

    @cached_property
    def decoded(self) -> tuple[Message, Header] | None:
        """Message and header, decoded when they are first read; None if the frame is invalid."""
        return valid_message(self.topic, self.key, self.payload)


class LatestCache:
    """Receiver of frames, as a ``Mailbox``, that keeps the newest one of each key."""

    def __init__(self) -> None:
        self._frames: dict[str, LatestFrame] = {}
        self.arrived_s = 0.0
        """Arrival of the newest frame of all (monotonic, s)."""

    def offer(self, topic: Topic | None, key: str, payload: bytes) -> None:
        """Replace the frame of a key; called on Zenoh's thread."""
        if topic is not None:
            frame = self._frames[key] = LatestFrame(topic, key, payload)
            self.arrived_s = frame.arrived_s

    def get(self, key: str) -> LatestFrame | None:
        """Return the newest frame of a key, or None."""
        return self._frames.get(key)

    def frames(self) -> list[LatestFrame]:
        """Return the newest frames of all keys."""
        return list(self._frames.copy().values())
