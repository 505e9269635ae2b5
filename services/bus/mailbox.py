"""Received frames of a process: a queue of all keys in the order of arrival, or the newest frames of each key.

Zenoh's receiving thread only stamps and stores frames, so a slow reader never blocks it. A full queue drops new frames
and counts them.
"""

from __future__ import annotations

import contextlib
import queue
import time
from collections import deque
from dataclasses import dataclass
from functools import cached_property

from ltv_mpc.messages import Message, Plan
from services.bus.topics import Topic
from services.bus.wire import Header, WireError, message_at, unpack

CAPACITY = 50_000  # frames: about 5 s of everything at 20 times real time, some 20 MB

HISTORY: dict[type[Message], int] = {Plan: 32}
"""Number of frames that are kept, other than one: 10 s of plans, one of which is in force at the actuators."""


@dataclass
class Frame:
    """Received frame, decoded when it is first asked for."""

    topic: Topic | None  # None for an unknown key
    key: str
    payload: bytes
    received_monotonic_us: int = 0
    attachment: bytes = b""  # of a message of another system

    @cached_property
    def decoded(self) -> tuple[Message, Header] | None:
        """Message and header, for an occasional reader; None if the frame is invalid, which others count."""
        with contextlib.suppress(WireError):
            return None if self.topic is None else message_at(self.topic, self.key, unpack(self.payload))
        return None

    @property
    def arrived_s(self) -> float:
        """Monotonic time of its arrival (s)."""
        return self.received_monotonic_us / 1e6


class Mailbox:
    """Ordered queue between Zenoh's thread and the step loop."""

    def __init__(self, capacity: int = CAPACITY) -> None:
        self._capacity = capacity
        self._queue: queue.SimpleQueue[Frame | None] = queue.SimpleQueue()
        self.overflowed = 0

    def offer(self, topic: Topic | None, key: str, payload: bytes, attachment: bytes = b"") -> None:
        """Append a frame; called on Zenoh's thread."""
        if self._queue.qsize() >= self._capacity:
            self.overflowed += 1
            return
        self._queue.put(Frame(topic, key, payload, time.monotonic_ns() // 1000, attachment))

    def wake(self) -> None:
        """Make a waiting ``take`` return at once; may be called from a signal handler."""
        self._queue.put(None)

    def take(self, timeout_s: float) -> Frame | None:
        """Take the oldest frame; return None after ``timeout_s`` or a ``wake``."""
        try:
            return self._queue.get(timeout=timeout_s) if timeout_s > 0 else self._queue.get_nowait()
        except queue.Empty:
            return None

    def __len__(self) -> int:
        return self._queue.qsize()


class LatestCache:
    """Newest frame of each key, or as many as ``HISTORY`` says, for occasional readers."""

    def __init__(self) -> None:
        self._frames: dict[str, deque[Frame]] = {}
        self.arrived_s = 0.0
        """Arrival of the newest frame of all (monotonic, s)."""

    def offer(self, topic: Topic | None, key: str, payload: bytes) -> None:
        """Add a frame to its key, in place of the oldest; called on Zenoh's thread."""
        if topic is not None:
            frame = Frame(topic, key, payload, time.monotonic_ns() // 1000)
            self._frames.setdefault(key, deque(maxlen=HISTORY.get(topic.message_type, 1))).append(frame)
            self.arrived_s = frame.arrived_s

    def get(self, key: str) -> Frame | None:
        """Return the newest frame of a key, or None."""
        return next(iter(self.recent(key)), None)

    def recent(self, key: str) -> list[Frame]:
        """Return the frames of a key that are kept, the newest first."""
        return list(self._frames.get(key, ()))[::-1]

    def frames(self) -> list[Frame]:
        """Return the newest frames of all keys."""
        newest = map(self.get, list(self._frames))
        return [frame for frame in newest if frame is not None]
