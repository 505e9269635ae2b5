"""Vehicle clock: one process, the clock master, announces the vehicle time; all others follow it. Integers throughout.

    vehicle time = vehicle_ns + (monotonic - at_monotonic) x speed_num / speed_den      while running

CLOCK_MONOTONIC is the same for all processes of one host, so a follower needs no synchronisation: it applies each
announced segment from that segment's own instant on. A change (start, pause, speed) is announced 50 ms
ahead. A follower that receives it too late holds its reading until the new segment catches up: a reading never steps
back.
"""

from __future__ import annotations

import time
from fractions import Fraction
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from ltv_mpc.messages import Clock, ClockState

BOOT_ID_FILE = Path("/proc/sys/kernel/random/boot_id")
NO_BOOT_ID = "unknown"
"""Boot id of a host that does not tell it."""
MAX_SPEED_DENOMINATOR = 1_000_000
MAX_SEGMENTS = 100
"""Announced segments that are kept. With a lead time of 50 ms only a few are in the future."""

EARLIEST_NS = -(2**63)


class ClockError(RuntimeError):
    """Clock that cannot be followed."""


def monotonic_us() -> int:
    """Return the host's CLOCK_MONOTONIC in microseconds."""
    return time.monotonic_ns() // 1000


@cache
def boot_id() -> str:
    """Return the boot id of this host. Monotonic clocks are comparable only within one boot of one host."""
    try:
        return BOOT_ID_FILE.read_text().strip()
    except OSError:
        return NO_BOOT_ID


def fraction_of(speed: float) -> Fraction:
    """Return a speed as a ratio of two integers, as it is announced."""
    return Fraction(speed).limit_denominator(MAX_SPEED_DENOMINATOR)


class ClockSegment(NamedTuple):
    """Segment of the piecewise linear clock: vehicle time as a function of monotonic time, from ``at_us`` on."""

    at_us: int
    vehicle_ns: int
    num: int
    den: int
    state: ClockState

    @classmethod
    def announced(cls, clock: Clock) -> ClockSegment:
        """Return the segment that an announcement describes."""
        return cls(clock.at_monotonic_us, clock.vehicle_ns, clock.speed_num, clock.speed_den, clock.state)

    def read(self, now_us: int) -> int:
        """Return the vehicle time (ns)."""
        if self.state is not ClockState.RUNNING or now_us <= self.at_us:
            return self.vehicle_ns
        return self.vehicle_ns + (now_us - self.at_us) * 1000 * self.num // self.den

    def due_us(self, t_ns: int) -> int | None:
        """Return the first monotonic time at which the segment reads ``t_ns`` or more; None if it never does.

        While the clock waits for the start nothing is due, not even the start itself.
        """
        if self.state is ClockState.WAITING:
            return None
        if t_ns <= self.vehicle_ns:
            return self.at_us
        if self.state is not ClockState.RUNNING:
            return None
        return self.at_us - (self.vehicle_ns - t_ns) * self.den // (1000 * self.num)


class VehicleClock:
    """Follower of the vehicle clock: reads the vehicle time from the segments announced so far.

    ``speed`` is the speed that this process expects, or None. Only the clock master's speed counts; a different one is
    an error.
    """

    def __init__(self, *, speed: float | None = None) -> None:
        self._speed = None if speed is None else fraction_of(speed)
        self._segments: list[ClockSegment] = []  # the active one, then those announced for later
        self._epoch = 0
        self._sequence = -1
        self._last_ns: int | None = None
        self._floor_ns = EARLIEST_NS  # last reading of the segments that have been dropped

    def set_segment(self, segment: ClockSegment) -> None:
        """Follow this segment, which was estimated because no clock is announced (``clock_sync.py``)."""
        self._segments = [segment]

    def follow(self, message: Clock) -> bool:
        """Apply an announcement. Return True if it is new. Raises ``ClockError`` if the clock cannot be followed."""
        if message.host_boot_id != boot_id():
            raise ClockError(
                f"the clock is kept on another host (boot {message.host_boot_id[:8]}, here {boot_id()[:8]}): "
                "all processes of a run must be on one host"
            )
        if self._segments and message.clock_epoch != self._epoch:
            raise ClockError("another plant has started its own clock: restart this process to follow it")
        if message.clock_sequence <= self._sequence:
            return False
        if not self._segments and self._speed not in (None, fraction_of(message.requested_speed)):
            raise ClockError(
                f"run.speed is {float(self._speed):g} here and {message.requested_speed:g} at the plant, "
                "whose value applies: start both with the same scenario"
            )
        self._epoch, self._sequence = message.clock_epoch, message.clock_sequence
        self._segments.append(ClockSegment.announced(message))
        if len(self._segments) > MAX_SEGMENTS:
            del self._segments[-2]  # neither the segments that are active soon nor the newest
        return True

    @property
    def newest(self) -> ClockSegment | None:
        """Segment that was announced last, whether it is active yet or not; None before the first."""
        return self._segments[-1] if self._segments else None

    def read(self, now_us: int) -> int | None:
        """Return the vehicle time (ns), never less than an earlier reading; None before the first segment is active."""
        while len(self._segments) > 1 and self._segments[1].at_us <= now_us:
            ended = self._segments.pop(0)
            self._floor_ns = max(self._floor_ns, ended.read(self._segments[0].at_us))
        if not self._segments or now_us < self._segments[0].at_us:
            return self._last_ns
        reading = max(self._floor_ns, self._segments[0].read(now_us))
        self._last_ns = reading if self._last_ns is None else max(self._last_ns, reading)
        return self._last_ns

    def at(self, instant_us: int) -> int | None:
        """Return the vehicle time (ns) at an instant; None before the first announcement.

        It depends on the segments alone, not on earlier readings. It does not step back either, where a new segment
        lies behind the one before.
        """
        if not self._segments:
            return None
        active = [segment for segment in self._segments if segment.at_us <= instant_us] or self._segments[:1]
        ends = (segment.read(following.at_us) for segment, following in pairwise(active))
        return max(self._floor_ns, *ends, active[-1].read(instant_us))

    def due_us(self, t_ns: int) -> int | None:
        """Return the monotonic time at which the clock will read ``t_ns``; None if it is paused before that."""
        for i, segment in enumerate(self._segments):
            due = segment.due_us(t_ns)
            last = i + 1 == len(self._segments)
            if due is not None and (last or due < self._segments[i + 1].at_us):
                return due
        return None
