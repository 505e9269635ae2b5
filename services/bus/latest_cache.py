"""Cache of the newest frames of each key, for occasional readers: a frame is decoded only when it is read."""

from __future__ import annotations

import time
from collections import deque
from functools import cached_property

from ltv_mpc.messages import Message, Plan
from services.bus.message_validation import valid_message
from services.bus.topics import Topic
from services.bus.wire import Header

HISTORY: dict[type[Message], int] = {Plan: 32}
"""Number of frames that are kept, other than one: 10 s of plans, one of which is in force at the actuators."""


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
    """Receiver of frames, as a ``Mailbox``, that keeps the newest one of each key, or as many as ``HISTORY`` says."""

    def __init__(self) -> None:
        self._frames: dict[str, deque[LatestFrame]] = {}
        self.arrived_s = 0.0
        """Arrival of the newest frame of all (monotonic, s)."""

    def offer(self, topic: Topic | None, key: str, payload: bytes) -> None:
        """Add a frame to its key, in place of the oldest; called on Zenoh's thread."""
        if topic is not None:
            frame = LatestFrame(topic, key, payload)
            kept = deque[LatestFrame](maxlen=HISTORY.get(topic.message_type, 1))
            self._frames.setdefault(key, kept).append(frame)
            self.arrived_s = frame.arrived_s

    def get(self, key: str) -> LatestFrame | None:
        """Return the newest frame of a key, or None."""
        return next(iter(self.recent(key)), None)

    def recent(self, key: str) -> list[LatestFrame]:
        """Return the frames of a key that are kept, the newest first."""
        return list(self._frames.get(key, ()))[::-1]

    def frames(self) -> list[LatestFrame]:
        """Return the newest frames of all keys."""
        newest = map(self.get, list(self._frames))
        return [frame for frame in newest if frame is not None]
