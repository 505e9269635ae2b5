"""Rate limits: frames of a source that sends too many are dropped before they are decoded.

Of each source so many frames a second pass, with bursts of half a second. So a source that floods delays no other one,
and it gains nothing by its short period. Only so many sources are admitted at a time; another one is as soon as one of
them has been silent for a second.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable

from ltv_mpc.messages import Applied, Estimate, Message
from services.bus.mailbox import Frame
from services.bus.wire import epoch_of

LIMITED: frozenset[type[Message]] = frozenset({Estimate, Applied})
"""Types that are limited: those from which other vehicles' publishers drive a controller, ten times a second.

Frames on unknown keys are limited, too.
"""

BURST_US = 500_000
SILENT_US = 1_000_000


class SourceLimit:
    """Limit of the frames a second of each source, and of the number of sources."""

    def __init__(self, per_s: float, sources: int) -> None:
        self._interval_us, self._sources = 1e6 / per_s, sources
        self._due_us: dict[Hashable, float] = {}  # generic cell rate algorithm: when the next is due

    def admits(self, source: Hashable, now_us: int, speed: float = 1.0) -> bool:
        """Return True if a frame is within the limit of its source; ``speed`` multiplies the limit."""
        due_us = self._due_us.get(source)
        if due_us is None:
            due_us = now_us
            if len(self._due_us) >= self._sources and not self._forget_silent(now_us):
                return False
        elif due_us > now_us + BURST_US:
            return False
        self._due_us[source] = max(due_us, now_us) + self._interval_us / speed
        return True

    def _forget_silent(self, now_us: int) -> bool:
        """Forget a source that is silent. Return False if there is none."""
        silent = next((source for source, due_us in self._due_us.items() if due_us < now_us - SILENT_US), None)
        if silent is None:
            return False
        del self._due_us[silent]
        return True


class RateLimit:
    """Limit of the frames that one process decodes: 16 sources, each 100 a second of vehicle time on a key."""

    def __init__(self, speed: Callable[[], float] = lambda: 1.0) -> None:
        """``speed``: vehicle seconds per second now."""
        self._speed, self._limit = speed, SourceLimit(100, 16)

    def admits(self, frame: Frame) -> bool:
        """Return True if a frame is within the limit of its source."""
        if frame.topic is not None and frame.topic.message_type not in LIMITED:
            return True
        source = frame.key, epoch_of(frame.payload)
        return self._limit.admits(source, frame.received_monotonic_us, self._speed())
