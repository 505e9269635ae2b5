"""Synchronisation with another side's clock, whose origin and rate differ from ours.

    its time = m + theta,   theta changes by at most rho = 1e-4 of the time that passes

m is our monotonic clock, its time whatever it stamps its messages with: Unix time, time since its boot. Nothing is
known of the delays on the way but that they are not negative; that bounds theta from both sides:

    a message that it stamped T when it sent it came to us at m      theta >= T - m    (by the delay towards us)
    a plan that we sent at m came to it at T, by its own report      theta <= T - m    (by the delay towards it)

Of either kind the tightest of each second is kept, for 30 s (``WINDOW_US``), and loosened by rho for its age. With both

    theta = (upper + lower) / 2,   error at most (upper - lower) / 2

which is half the smallest round trip of that time, or less where the smallest delays of both ways fell into different
exchanges, and what drift may have added since: NTP's clock filter (RFC 5905, section 10) with bounds in the place of
averages. Delays that jump, messages out of order, doubled or lost only leave the bounds wider. Without reports of plans

    theta = lower + d

with d the smallest delay towards us, as it was told, else 0: the reading is then behind by that delay less d, and
nothing that is sent one way only can tell by how much.

A stamp that contradicts the bounds, or differs from them by more than any message is late, is not believed; the third
in a row is: its clock was set, what was heard before is forgotten, and that is counted.
"""

from __future__ import annotations

from collections import OrderedDict
from typing import NamedTuple

from ltv_mpc.messages import Applied, ClockMode, ClockState, Estimate, Message
from services.runtime.clock import ClockSegment, VehicleClock

WINDOW_US = 30_000_000
BUCKET_US = 1_000_000
DRIFT_US_PER_S = 100
"""rho: two crystals of 50 ppm each. A clock that is slewed by more than that is soon taken for one that was set."""

MAX_DELAY_NS = 10_000_000_000
"""No message is later than this."""

STEP_DETECTED_AT = 3
"""So many stamps in a row that contradict the bounds are right, and the bounds are wrong."""


GRACE_US = 500_000
"""Time without a published clock after which the other side's stamps count: a clock is repeated ten times a second."""

MAX_PENDING_PLANS = 200
"""Plans whose receipt may still be reported: a minute of them."""

STAMPED_INPUTS = (Estimate, Applied)
"""Inputs that carry the time of the other side."""


class ClockOffset(NamedTuple):
    """What is known of theta at one instant."""

    mode: ClockMode
    offset_ns: int
    error_ns: int | None  # at most so far off; None: nobody can tell


SHARED_CLOCK = ClockOffset(ClockMode.SHARED, 0, 0)
"""One clock for all: nothing to find out."""


class OffsetBounds:
    """The tightest bound of each second, from one side. ``sign`` 1: from below, -1: from above."""

    def __init__(self, sign: int) -> None:
        self._sign = sign
        self._by_second: dict[int, tuple[int, int]] = {}  # sign x bound, and when it was had

    def keep(self, bound_ns: int, m_us: int) -> None:
        """One more."""
        new, second = (self._sign * bound_ns, m_us), m_us // BUCKET_US
        self._by_second[second] = max(self._by_second.get(second, new), new)

    def drop(self, before_us: int) -> None:
        """Forget what is older."""
        for second in [key for key, (_, at) in self._by_second.items() if at < before_us]:
            del self._by_second[second]

    def tightest(self, now_us: int) -> int | None:
        """At ``now_us``, each loosened by what drift can have come to; None where there is none."""
        loosened = (bound - drift_ns(now_us - at) for bound, at in self._by_second.values())
        best = max(loosened, default=None)
        return None if best is None else self._sign * best


class ClockOffsetEstimator:
    """OffsetBounds of theta. Pure: all times are handed in, ours in microseconds, theirs in nanoseconds."""

    def __init__(self, *, input_delay_ns: int = 0) -> None:
        """``input_delay_ns``: the smallest delay of what comes from there, counted in one-way mode."""
        self._input_delay_ns = input_delay_ns
        self._lower, self._upper = OffsetBounds(1), OffsetBounds(-1)
        self._newest_us: int | None = None
        self._doubted = 0  # stamps in a row
        self.clock_steps = 0

    def add_stamp(self, t_ns: int, m_us: int) -> bool:
        """A message that it stamped ``t_ns``, when it sent it or earlier, has come at ``m_us``: may it be believed?"""
        bound = t_ns - m_us * 1000
        low, high = self._lower.tightest(m_us), self._upper.tightest(m_us)
        above = low is not None and bound > (low + MAX_DELAY_NS if high is None else high)
        below = low is not None and bound < low - MAX_DELAY_NS
        if above or below:
            self._doubted += 1
            if self._doubted < STEP_DETECTED_AT:
                return False
            self._lower, self._upper = OffsetBounds(1), OffsetBounds(-1)
            self.clock_steps += 1
        self._doubted = 0
        self._lower.keep(bound, m_us)
        self._age(m_us)
        return True

    def add_receipt(self, t_ns: int, m_us: int) -> None:
        """What we sent at ``m_us``, or later, came to it at ``t_ns``, as it says."""
        bound = t_ns - m_us * 1000
        low = self._lower.tightest(m_us)
        if low is not None and low <= bound <= low + 2 * MAX_DELAY_NS:
            self._upper.keep(bound, m_us)
            self._age(m_us)

    def read(self, now_us: int) -> ClockOffset | None:
        """theta at ``now_us``; None before the first message."""
        low, high = self._lower.tightest(now_us), self._upper.tightest(now_us)
        if low is None:
            return None
        if high is None:
            return ClockOffset(ClockMode.ONE_WAY, low + self._input_delay_ns, None)
        return ClockOffset(ClockMode.TWO_WAY, (high + low) // 2, (high - low + 1) // 2)

    def _age(self, m_us: int) -> None:
        """Old bounds go when newer ones come, so that after a silence there are still some."""
        self._newest_us = m_us if self._newest_us is None else max(m_us, self._newest_us)
        for bounds in (self._lower, self._upper):
            bounds.drop(self._newest_us - WINDOW_US)


def drift_ns(age_us: int) -> int:
    """What drift can come to in so long."""
    return -(-abs(age_us) * DRIFT_US_PER_S // 1000)


class ClockSync:
    """Choice of the clock that a process follows, when its inputs may come from a side with a clock of its own.

    If a ``clock`` is published, the process follows it. If none has arrived within ``GRACE_US`` of the first input, the
    process sets ``clock`` from the stamps of its inputs and from the other side's reports of what it received.
    """

    def __init__(self, clock: VehicleClock, *, epoch: int, input_delay_ns: int = 0) -> None:
        """``epoch``: under which this process publishes."""
        self._clock = clock
        self._epoch = epoch
        self._theirs = ClockOffsetEstimator(input_delay_ns=input_delay_ns)
        self._sent_us: OrderedDict[int, int] = OrderedDict()  # by sequence
        self._first_us: int | None = None
        self.active = False

    @property
    def clock_steps(self) -> int:
        """How often the other side has set its clock."""
        return self._theirs.clock_steps

    def offset(self, now_us: int) -> ClockOffset:
        """By which clock the process goes, and how far off it may be."""
        reading = self._theirs.read(now_us) if self.active else None
        return reading or SHARED_CLOCK

    def on_plan_sent(self, sequence: int, m_us: int) -> None:
        """A plan of that number goes out."""
        self._sent_us[sequence] = m_us
        while len(self._sent_us) > MAX_PENDING_PLANS:
            self._sent_us.popitem(last=False)

    def check_stamp(self, signal: Message, m_us: int) -> str:
        """An input came at ``m_us``. Why it must not be believed; empty where it may."""
        if not isinstance(signal, STAMPED_INPUTS) or (self._clock.newest is not None and not self.active):
            return ""  # with a clock for all the stamps are by that one, at whatever speed it goes
        if self._first_us is None:
            self._first_us = m_us
        clock_steps = self.clock_steps
        if not self._theirs.add_stamp(signal.t_ns, m_us):
            return "t_ns contradicts the clock of all earlier stamps"
        if self.active and self.clock_steps > clock_steps:
            self._clock.reset()
        if isinstance(signal, Applied) and signal.plan_epoch == self._epoch and signal.plan_sequence in self._sent_us:
            self._theirs.add_receipt(signal.plan_received_t_ns, self._sent_us[signal.plan_sequence])
        self._set(m_us, self._first_us)
        return ""

    def _set(self, m_us: int, first_us: int) -> None:
        reading = self._theirs.read(m_us)
        if m_us - first_us < GRACE_US or reading is None:
            return
        self.active = True
        self._clock.set_segment(ClockSegment(m_us, m_us * 1000 + reading.offset_ns, 1, 1, ClockState.RUNNING))
