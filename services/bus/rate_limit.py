"""Rate limit of the sources of a key: frames above it are dropped before they are decoded.

Of each source, by the epoch in its frames, at most 100 frames a second of vehicle time pass, with bursts of half a
second. So a source that floods a key delays no other one, and it gains nothing by its short period. At most
``MAX_SOURCES`` are admitted at a time; another one is as soon as one of them has been silent for a second.
"""

from __future__ import annotations

from collections.abc import Callable

from ltv_mpc.messages import Applied, Estimate, Message
from services.bus.mailbox import Frame
from services.bus.wire import epoch_of

LIMITED: frozenset[type[Message]] = frozenset({Estimate, Applied})
"""Types that are limited: those from which other vehicles' publishers drive a controller, ten times a second.

Frames on unknown keys are limited, too.
"""

INTERVAL_US = 10_000
BURST_US = 500_000
SILENT_US = 1_000_000
MAX_SOURCES = 16


class RateLimit:
    """Limit of the frames that one process decodes."""

    def __init__(self, speed: Callable[[], float] = lambda: 1.0) -> None:
        """``speed``: vehicle seconds per second now."""
        self._speed = speed
        self._due_us: dict[tuple[str, int | None], float] = {}  # generic cell rate algorithm: when the next is due

    def admits(self, frame: Frame) -> bool:
        """Return True if a frame is within the limit of its source."""
        if frame.topic is not None and frame.topic.message_type not in LIMITED:
            return True
        now_us, source = frame.received_monotonic_us, (frame.key, epoch_of(frame.payload))
        due_us = self._due_us.get(source)
        if due_us is None:
            due_us = now_us
            if len(self._due_us) >= MAX_SOURCES and not self._forget_silent(now_us):
                return False
        elif due_us > now_us + BURST_US:
            return False
        self._due_us[source] = max(due_us, now_us) + INTERVAL_US / self._speed()
        return True

    def _forget_silent(self, now_us: int) -> bool:
        """Forget a source that is silent. Return False if there is none."""
        silent = next((source for source, due_us in self._due_us.items() if due_us < now_us - SILENT_US), None)
        if silent is None:
            return False
        del self._due_us[silent]
        return True
