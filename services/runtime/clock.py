"""Vehicle time, in integers: one process keeps it, all others follow what it announces.

    vehicle time = vehicle_ns + (monotonic - at_monotonic) x speed_num / speed_den      while running

CLOCK_MONOTONIC is the same for all processes of one host, so a follower needs no exchange: it applies the newest line
at that line's own instant. A change (start, pause, speed) is announced at least ``LEAD_US`` ahead. Who hears of it late
holds still until the new line catches up: a reading never steps back.
"""

from __future__ import annotations

import time
from fractions import Fraction
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from ltv_mpc.messages import Clock, ClockState

LEAD_US = 50_000
"""How far ahead a change is announced: many times a message's way through a router."""

BOOT_ID_FILE = Path("/proc/sys/kernel/random/boot_id")
MAX_SPEED_DENOMINATOR = 1_000_000
MAX_SEGMENTS = 100
"""Announcements that are kept: 50 ms ahead at most a few are on their way."""

EARLIEST_NS = -(2**63)


class ClockError(RuntimeError):
    """A clock that cannot be followed."""


def monotonic_us() -> int:
    """The host's CLOCK_MONOTONIC."""
    return time.monotonic_ns() // 1000


@cache
def boot_id() -> str:
    """Which boot of which host this is: monotonic clocks are comparable within one only."""
    try:
        return BOOT_ID_FILE.read_text().strip()
    except OSError:
        return "unknown"


def fraction_of(speed: float) -> Fraction:
    """A speed as it travels: two integers."""
    return Fraction(speed).limit_denominator(MAX_SPEED_DENOMINATOR)


class ClockSegment(NamedTuple):
    """Vehicle time as a function of monotonic time, from ``at_us`` on."""

    at_us: int
    vehicle_ns: int
    num: int
    den: int
    state: ClockState

    def read(self, now_us: int) -> int:
        """Vehicle time (ns)."""
        if self.state is not ClockState.RUNNING or now_us <= self.at_us:
            return self.vehicle_ns
        return self.vehicle_ns + (now_us - self.at_us) * 1000 * self.num // self.den

    def due_us(self, t_ns: int) -> int | None:
        """The first monotonic time at which it reads ``t_ns`` or more; None where it stands still before that.

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
    """A follower: reads vehicle time from the lines announced so far.

    ``speed`` is what this process was told to expect, if anything: the time-keeper's counts, and another is an error.
    """

    def __init__(self, *, speed: float | None = None) -> None:
        self._speed = None if speed is None else fraction_of(speed)
        self._lines: list[ClockSegment] = []  # in force, then those announced for later
        self._epoch = 0
        self._sequence = -1
        self._last_ns: int | None = None
        self._held_ns = EARLIEST_NS  # what the lines before the first one came to

    def set_segment(self, line: ClockSegment) -> None:
        """Go by this line from its instant on: nobody announces one, and it was found out."""
        self._lines = [line]

    def reset(self) -> None:
        """Forget what was read: the next reading may be before it."""
        self._lines, self._last_ns = [], None

    def follow(self, message: Clock) -> bool:
        """Take an announcement; whether it is news. Raises ``ClockError`` for a clock that cannot be followed."""
        if message.host_boot_id != boot_id():
            raise ClockError(
                f"the clock is kept on another host (boot {message.host_boot_id[:8]}, here {boot_id()[:8]}): "
                "all processes of a run must be on one host"
            )
        if self._lines and message.clock_epoch != self._epoch:
            raise ClockError("another plant has started its own clock: restart this process to follow it")
        if message.clock_sequence <= self._sequence:
            return False
        if not self._lines and self._speed not in (None, fraction_of(message.requested_speed)):
            raise ClockError(
                f"run.speed is {float(self._speed):g} here and {message.requested_speed:g} at the plant, where "
                "alone it counts: start both with one scenario"
            )
        self._epoch, self._sequence = message.clock_epoch, message.clock_sequence
        line = ClockSegment(
            message.at_monotonic_us, message.vehicle_ns, message.speed_num, message.speed_den, message.state
        )
        self._lines.append(line)
        if len(self._lines) > MAX_SEGMENTS:
            del self._lines[-2]  # neither one that is soon in force nor the newest
        return True

    @property
    def newest(self) -> ClockSegment | None:
        """What was announced last, in force or not."""
        return self._lines[-1] if self._lines else None

    def read(self, now_us: int) -> int | None:
        """Vehicle time (ns); None before the first line is in force. Never less than an earlier reading."""
        while len(self._lines) > 1 and self._lines[1].at_us <= now_us:
            ended = self._lines.pop(0)
            self._held_ns = max(self._held_ns, ended.read(self._lines[0].at_us))
        if not self._lines or now_us < self._lines[0].at_us:
            return self._last_ns
        reading = self._lines[0].read(now_us)
        self._last_ns = reading if self._last_ns is None else max(self._last_ns, reading)
        return self._last_ns

    def at(self, instant_us: int) -> int | None:
        """Vehicle time (ns) at an instant, whatever was read before; None before the first line is heard.

        A function of the lines alone: it too holds still where a new line lies behind the one before.
        """
        if not self._lines:
            return None
        heard = [line for line in self._lines if line.at_us <= instant_us] or self._lines[:1]
        ends = (line.read(following.at_us) for line, following in pairwise(heard))
        return max(self._held_ns, *ends, heard[-1].read(instant_us))

    def due_us(self, t_ns: int) -> int | None:
        """When the clock reads ``t_ns`` as far as is announced; None where it stands still before that."""
        for i, line in enumerate(self._lines):
            due = line.due_us(t_ns)
            last = i + 1 == len(self._lines)
            if due is not None and (last or due < self._lines[i + 1].at_us):
                return due
        return None


class ClockSource:
    """The one who says what time it is. Its messages are repeated as they are, so that late joiners hear them."""

    def __init__(self, *, epoch: int, start_ns: int, speed: float, now_us: int) -> None:
        self._speed = self._requested = fraction_of(speed)
        self.slipped_ns = 0  # vehicle time that the wall could not keep up with, in all
        self.slips = 0  # how many times
        self.message = Clock(
            clock_epoch=epoch,
            clock_sequence=0,
            host_boot_id=boot_id(),
            at_monotonic_us=now_us,
            vehicle_ns=start_ns,
            speed_num=self._speed.numerator,
            speed_den=self._speed.denominator,
            requested_speed=float(self._requested),
            state=ClockState.WAITING,
        )

    @property
    def speed(self) -> Fraction:
        """Vehicle seconds per second, as asked for."""
        return self._requested

    def run(self, now_us: int) -> Clock:
        """Start, or go on after a pause."""
        return self._announce(now_us, ClockState.RUNNING)

    def pause(self, now_us: int) -> Clock:
        """Stand still."""
        return self._announce(now_us, ClockState.PAUSED)

    def set_speed(self, now_us: int, speed: Fraction, *, requested: float | None = None) -> Clock:
        """Go on at what the machine can do of the speed that was asked for, or is ``asked`` for now."""
        self._speed = speed
        if requested is not None:
            self._requested = fraction_of(requested)
        return self._announce(now_us, self.message.state)

    def slip(self, now_us: int, late_us: int) -> Clock:
        """Give up ``late_us`` of wall time that cannot be caught up with: the clock stands still that much longer."""
        self.slips += 1
        slip_ns = late_us * 1000 * self._speed.numerator // self._speed.denominator
        self.slipped_ns += slip_ns
        return self._announce(now_us, self.message.state, slip_ns=slip_ns)

    def _announce(self, now_us: int, state: ClockState, *, slip_ns: int = 0) -> Clock:
        old = self.message
        line = ClockSegment(old.at_monotonic_us, old.vehicle_ns, old.speed_num, old.speed_den, old.state)
        at_us = max(now_us + LEAD_US, old.at_monotonic_us)
        self.message = Clock(
            clock_epoch=old.clock_epoch,
            clock_sequence=old.clock_sequence + 1,
            host_boot_id=old.host_boot_id,
            at_monotonic_us=at_us,
            vehicle_ns=line.read(at_us) - slip_ns,
            speed_num=self._speed.numerator,
            speed_den=self._speed.denominator,
            requested_speed=float(self._requested),
            state=state,
        )
        return self.message
