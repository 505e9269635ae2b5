"""Mailbox of a process: one queue of the frames of all keys, in the order of their arrival.

Zenoh's receiving thread only stamps and appends frames, so a slow reader never blocks it. The step loop takes them. A
full queue drops new frames and counts them.
"""

from __future__ import annotations

import queue
import time
from typing import NamedTuple

from services.bus.topics import Topic

CAPACITY = 50_000  # frames: about 5 s of everything at 20 times real time, some 20 MB


class Frame(NamedTuple):
    """Received frame, not decoded yet."""

    topic: Topic | None  # None for an unknown key
    key: str
    payload: bytes
    received_monotonic_us: int
    attachment: bytes = b""  # of a message of another system


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
