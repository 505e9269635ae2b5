"""Offset of one publisher's clock, whose origin and rate differ from ours, and recognition of its steps.

    T = m + theta,   theta drifts by at most rho = 1e-4 of the elapsed time

T is the publisher's time, with which it stamps its messages: Unix time, or time since its boot. m is our monotonic
clock, and theta the offset. Transport delays are unknown, but never negative, so they bound theta from both sides:

    a message stamped T when it was sent arrives here at m           theta >= T - m    (differs by the delay to us)
    a plan sent from here at m arrives there at T, as reported       theta <= T - m    (differs by the delay to it)

For each direction the tightest bound of each second is kept for 30 s (``WINDOW_US``) and loosened by rho times its age.

    two-way mode:   theta = (upper + lower) / 2,   error at most (upper - lower) / 2

The error is half the smallest round trip of that time plus drift, or less if the smallest delays of the two directions
belong to different exchanges. This is NTP's clock filter (RFC 5905, section 10) with bounds in place of averages.
A clock that is set by less than a round trip contradicts no bound: until the old ones have aged, the reading is off by
at most that round trip. Delays that jump, and messages that are out of order, duplicated or lost, only leave the bounds
wider.

    one-way mode (no reports of received plans):   theta = lower + d

d is the smallest delay to us, from the settings, else 0. The reading is then behind by the true smallest delay minus d;
one-way messages cannot tell how much that is.

A clock that is set makes the bounds contradict each other, because it moves theta. Then the old bounds are discarded:

    forward    three stamps in a row lie above the upper bound and agree with each other. Without an upper bound they
               must exceed the lower one by more than the usual variation of the delays.
    backward   the receipts of three plans in a row lie below the lower bound; or three stamps are later than any delay
               (``MAX_DELAY_NS``) and agree; or all stamps of one second are late by the same amount, and no receipt
               contradicts that. The last case may also be a congested link: the step is then not ``certain``.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

from ltv_mpc.messages import ClockMode

WINDOW_US = 30_000_000
BUCKET_US = 1_000_000
DRIFT_US_PER_S = 100
"""Drift bound rho: two crystals of 50 ppm each. A clock that is slewed faster soon counts as one that was set."""

MAX_DELAY_NS = 10_000_000_000
"""Largest plausible transport delay."""

STEP_DETECTED_AT = 3
"""Number of contradictions in a row after which the bounds are taken to be wrong."""

MIN_VARIATION_NS = 50_000_000
"""Smallest variation of the delays that is assumed: stamps that differ by less agree."""

LATE_NS = 250_000_000
"""Smallest lateness that can count as a step. It is half the age from which the health is degraded."""

LATE_US = 1_000_000
"""Duration of a constant lateness after which the clock counts as set back."""

SETTLING_US = 500_000
"""Time from a publisher's first stamp in which every stamp may raise the lower bound: the first may have been slow."""

DELAYS_KEPT = 31


class ClockOffset(NamedTuple):
    """Offset theta to the publisher's clock at one instant."""

    mode: ClockMode
    offset_ns: int
    error_ns: int | None  # error bound; None if unknown, in one-way mode


class _Bound(NamedTuple):
    """Bound of theta, and the monotonic time (us) at which it was found."""

    ns: int
    m_us: int

    @property
    def t_ns(self) -> int:
        """Time of the publisher."""
        return self.ns + self.m_us * 1000


class OffsetBounds:
    """Tightest bound of each second, from one side: ``sign`` 1 for lower bounds, -1 for upper bounds."""

    def __init__(self, sign: int) -> None:
        self._sign = sign
        self._by_second: dict[int, tuple[int, int]] = {}  # sign x bound (ns), and the monotonic time (us)

    def add(self, bound_ns: int, m_us: int) -> None:
        """Add a bound that was found at ``m_us``."""
        new, second = (self._sign * bound_ns, m_us), m_us // BUCKET_US
        self._by_second[second] = max(self._by_second.get(second, new), new)

    def drop(self, before_us: int) -> None:
        """Discard the bounds before ``before_us``."""
        for second in [key for key, (_, at) in self._by_second.items() if at < before_us]:
            del self._by_second[second]

    def tightest(self, now_us: int) -> int | None:
        """Return the tightest bound at ``now_us``, each loosened by the possible drift; None if there is none."""
        # The drift is rounded up. This is inline because each message asks ten times, for thirty bounds each.
        loosened = [bound + -abs(now_us - at) * DRIFT_US_PER_S // 1000 for bound, at in self._by_second.values()]
        return self._sign * max(loosened) if loosened else None


@dataclass
class _Suspects:
    """Stamps and receipts in a row that suggest a step of the clock."""

    contradictions: tuple[_Bound, ...] = ()
    late: tuple[_Bound, ...] = ()
    receipts: dict[int, _Bound] = field(default_factory=dict)  # by the time at which the plan was sent


class ClockOffsetEstimator:
    """Estimator of theta by bounds. It reads no clock: our times are in us, the publisher's in ns."""

    def __init__(self, *, input_delay_ns: int = 0) -> None:
        """``input_delay_ns``: smallest delay of the publisher's messages, used in one-way mode."""
        self._input_delay_ns = input_delay_ns
        self._lower, self._upper = OffsetBounds(1), OffsetBounds(-1)
        self._settled_us: int | None = None  # end of the settling time
        self._newest = _Bound(0, 0)  # by the newest accepted stamp
        self._suspects = _Suspects()
        self._delays: deque[int] = deque(maxlen=DELAYS_KEPT)  # of the last stamps, above the smallest (ns)
        self.stamps = 0
        """Number of accepted stamps."""
        self.clock_steps = 0
        self.stepped_us = -1
        """Monotonic time at which the last step was recognised; -1 before the first."""
        self.certain = True
        """False if the last step was recognised by lateness alone."""

    def add_stamp(self, t_ns: int, m_us: int) -> bool:
        """Add the stamp ``t_ns`` of a message that arrived at ``m_us``. Return False if it is rejected.

        The stamp is the publisher's time when it sent the message, or earlier.
        """
        stamp = _Bound(t_ns - m_us * 1000, m_us)
        low, high = self._lower.tightest(m_us), self._upper.tightest(m_us)
        if low is None or self._settled_us is None:
            self._settled_us = m_us + SETTLING_US
        elif self._contradicts(stamp, low, high):
            ahead = self._suspects.contradictions = (*self._suspects.contradictions[1 - STEP_DETECTED_AT :], stamp)
            if len(ahead) < STEP_DETECTED_AT or not self._agree(ahead):
                return False
            self._step(ahead, certain=True)
        elif stamp.ns < low - max(LATE_NS, self._variation_ns):
            self._add_late(stamp)
        else:
            self._suspects.contradictions = self._suspects.late = ()
            self._delays.append(max(low - stamp.ns, 0))
        self.stamps += 1
        self._newest = stamp
        self._lower.add(*stamp)
        self._age()
        return True

    def add_receipt(self, t_ns: int, m_us: int) -> bool:
        """Add the report, in the newest message, that a plan sent at ``m_us``, or later, arrived there at ``t_ns``.

        Return False if it contradicts the bounds. A receipt that is reported again counts once.
        """
        receipt = _Bound(t_ns - m_us * 1000, m_us)
        low = self._lower.tightest(m_us)
        if low is None or receipt.ns > low + 2 * MAX_DELAY_NS:
            return False
        suspects = self._suspects
        if receipt.ns >= low:
            suspects.receipts.clear()
            # If it is newer than the first late stamp, their link is slow. One from before a step back is later than
            # the stamp of the message that reports it.
            if suspects.late and suspects.late[0].t_ns <= t_ns <= self._newest.t_ns:
                suspects.late = ()
            self._upper.add(*receipt)
            self._age()
            return True
        suspects.receipts[m_us] = receipt
        if len(suspects.receipts) < STEP_DETECTED_AT:
            return False
        self._step((self._newest,), certain=True)
        for of_plan in suspects.receipts.values():
            self._upper.add(*of_plan)
        return True

    def read(self, now_us: int) -> ClockOffset:
        """Return the offset at ``now_us``; 0 before the first message."""
        low, high = self._lower.tightest(now_us) or 0, self._upper.tightest(now_us)
        if high is None:
            return ClockOffset(ClockMode.ONE_WAY, low + self._input_delay_ns, None)
        return ClockOffset(ClockMode.TWO_WAY, (high + low) // 2, (high - low + 1) // 2)

    @property
    def heard_us(self) -> int:
        """Monotonic time at which the newest accepted stamp arrived."""
        return self._newest.m_us

    def agrees(self, other: ClockOffsetEstimator, now_us: int, late_ns: int) -> bool:
        """Return True if the stamps may come from ``other``'s clock, with at most ``late_ns`` more delay."""
        low, other_low = self._lower.tightest(now_us), other._lower.tightest(now_us)
        other_high = other._upper.tightest(now_us)
        if low is None or other_low is None:
            return True
        return other_low - late_ns <= low <= (other_low + late_ns if other_high is None else other_high)

    @property
    def _variation_ns(self) -> int:
        """Usual variation of the delays: twice their median, which a few stalls do not change."""
        return max(2 * sorted(self._delays)[len(self._delays) // 2] if self._delays else 0, MIN_VARIATION_NS)

    def _contradicts(self, stamp: _Bound, low: int, high: int | None) -> bool:
        """Return True if a stamp cannot come from the clock of the bounds."""
        if stamp.ns < low - MAX_DELAY_NS:
            return True
        if high is not None:
            return stamp.ns > high
        settling = self._settled_us is not None and stamp.m_us < self._settled_us
        return stamp.ns > low + MIN_VARIATION_NS and not settling and stamp.ns > low + self._variation_ns

    def _add_late(self, stamp: _Bound) -> None:
        """Add a late stamp. If those of the last second are late by the same amount, the clock was set."""
        self._suspects.contradictions = ()
        late = (*self._suspects.late, stamp)
        while len(late) > STEP_DETECTED_AT and stamp.m_us - late[1].m_us >= LATE_US:
            late = late[1:]
        self._suspects.late = late
        if len(late) >= STEP_DETECTED_AT and stamp.m_us - late[0].m_us >= LATE_US and self._agree(late):
            self._step(late, certain=bool(self._suspects.receipts))

    def _agree(self, bounds: tuple[_Bound, ...]) -> bool:
        return max(bounds).ns - min(bounds).ns <= self._variation_ns

    def _step(self, stamps: tuple[_Bound, ...], *, certain: bool) -> None:
        """Discard all bounds but those of ``stamps``: the clock was set."""
        self._lower, self._upper = OffsetBounds(1), OffsetBounds(-1)
        for stamp in stamps:
            self._lower.add(*stamp)
        self._suspects = _Suspects()
        self.clock_steps += 1
        self.stepped_us = stamps[-1].m_us
        self.certain = certain

    def _age(self) -> None:
        """Discard old bounds. This happens only when newer ones arrive, so that some are left after a silence."""
        for bounds in (self._lower, self._upper):
            bounds.drop(self._newest.m_us - WINDOW_US)
