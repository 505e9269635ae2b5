"""Synchronisation with another side's clock, whose origin and rate differ from ours.

    T = m + theta,   theta drifts by at most rho = 1e-4 of the elapsed time

T is the other side's time, with which it stamps its messages: Unix time, or time since its boot. m is our monotonic
clock, and theta the offset. Transport delays are unknown, but never negative, so they bound theta from both sides:

    a message stamped T when it was sent arrives here at m           theta >= T - m    (differs by the delay to us)
    a plan sent from here at m arrives there at T, as reported       theta <= T - m    (differs by the delay to it)

For each direction the tightest bound of each second is kept for 30 s (``WINDOW_US``) and loosened by rho times its age.

    two-way mode:   theta = (upper + lower) / 2,   error at most (upper - lower) / 2

The error is half the smallest round trip of that time plus drift, or less if the smallest delays of the two directions
belong to different exchanges. This is NTP's clock filter (RFC 5905, section 10) with bounds in place of averages.
Delays that jump, and messages that are out of order, duplicated or lost, only leave the bounds wider.

    one-way mode (no reports of received plans):   theta = lower + d

d is the smallest delay to us, from the settings, else 0. The reading is then behind by the true smallest delay minus d;
one-way messages cannot tell how much that is.

A stamp that contradicts the bounds, or differs from them by more than ``MAX_DELAY_NS``, is rejected. The third one in a
row is accepted: the other side has set its clock. The old bounds are then discarded, and the clock step is counted.
"""

from __future__ import annotations

from collections import OrderedDict
from typing import NamedTuple

from ltv_mpc.messages import Applied, ClockMode, ClockState, Estimate, Message
from services.runtime.clock import ClockSegment, VehicleClock

WINDOW_US = 30_000_000
BUCKET_US = 1_000_000
DRIFT_US_PER_S = 100
"""Drift bound rho: two crystals of 50 ppm each. A clock that is slewed faster soon counts as one that was set."""

MAX_DELAY_NS = 10_000_000_000
"""Largest plausible transport delay."""

STEP_DETECTED_AT = 3
"""Number of contradicting stamps in a row after which the bounds are taken to be wrong."""


GRACE_US = 500_000
"""Time without a published clock after which the other side's stamps count: a clock is repeated ten times a second."""

MAX_PENDING_PLANS = 200
"""Plans whose receipt may still be reported, a minute of them."""

STAMPED_INPUTS = (Estimate, Applied)
"""Inputs that carry the other side's time."""


class ClockOffset(NamedTuple):
    """Offset theta to the other side's clock at one instant."""

    mode: ClockMode
    offset_ns: int
    error_ns: int | None  # error bound; None if unknown, in one-way mode


SHARED_CLOCK = ClockOffset(ClockMode.SHARED, 0, 0)
"""Offset if one clock is announced for all processes."""


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
        loosened = (bound - drift_ns(now_us - at) for bound, at in self._by_second.values())
        best = max(loosened, default=None)
        return None if best is None else self._sign * best


class ClockOffsetEstimator:
    """Estimator of theta by bounds. It reads no clock: our times are in us, the other side's in ns."""

    def __init__(self, *, input_delay_ns: int = 0) -> None:
        """``input_delay_ns``: smallest delay of the other side's messages, used in one-way mode."""
        self._input_delay_ns = input_delay_ns
        self._lower, self._upper = OffsetBounds(1), OffsetBounds(-1)
        self._newest_us: int | None = None
        self._contradictions = 0  # in a row
        self.clock_steps = 0

    def add_stamp(self, t_ns: int, m_us: int) -> bool:
        """Add the stamp ``t_ns`` of a message that arrived at ``m_us``. Return False if it is rejected.

        The stamp is the other side's time when it sent the message, or earlier.
        """
        bound = t_ns - m_us * 1000
        low, high = self._lower.tightest(m_us), self._upper.tightest(m_us)
        above = low is not None and bound > (low + MAX_DELAY_NS if high is None else high)
        below = low is not None and bound < low - MAX_DELAY_NS
        if above or below:
            self._contradictions += 1
            if self._contradictions < STEP_DETECTED_AT:
                return False
            self._lower, self._upper = OffsetBounds(1), OffsetBounds(-1)
            self.clock_steps += 1
        self._contradictions = 0
        self._lower.add(bound, m_us)
        self._age(m_us)
        return True

    def add_receipt(self, t_ns: int, m_us: int) -> None:
        """Add the report that a message sent at ``m_us``, or later, arrived at the other side at ``t_ns``."""
        bound = t_ns - m_us * 1000
        low = self._lower.tightest(m_us)
        if low is not None and low <= bound <= low + 2 * MAX_DELAY_NS:
            self._upper.add(bound, m_us)
            self._age(m_us)

    def read(self, now_us: int) -> ClockOffset | None:
        """Return the offset at ``now_us``; None before the first message."""
        low, high = self._lower.tightest(now_us), self._upper.tightest(now_us)
        if low is None:
            return None
        if high is None:
            return ClockOffset(ClockMode.ONE_WAY, low + self._input_delay_ns, None)
        return ClockOffset(ClockMode.TWO_WAY, (high + low) // 2, (high - low + 1) // 2)

    def _age(self, m_us: int) -> None:
        """Discard old bounds. This happens only when newer ones arrive, so that some are left after a silence."""
        self._newest_us = m_us if self._newest_us is None else max(m_us, self._newest_us)
        for bounds in (self._lower, self._upper):
            bounds.drop(self._newest_us - WINDOW_US)


def drift_ns(age_us: int) -> int:
    """Return the largest drift within ``age_us``."""
    return -(-abs(age_us) * DRIFT_US_PER_S // 1000)


class ClockSync:
    """Choice of the clock that a process follows, when its inputs may come from a side with a clock of its own.

    If a ``clock`` is published, the process follows it. If none has arrived within ``GRACE_US`` of the first input, the
    process sets ``clock`` from the stamps of its inputs and from the other side's reports of what it received.
    """

    def __init__(self, clock: VehicleClock, *, epoch: int, input_delay_ns: int = 0) -> None:
        """``epoch``: the epoch under which this process publishes its plans."""
        self._clock = clock
        self._epoch = epoch
        self._estimator = ClockOffsetEstimator(input_delay_ns=input_delay_ns)
        self._sent_us: OrderedDict[int, int] = OrderedDict()  # by sequence
        self._first_us: int | None = None
        self.active = False

    @property
    def clock_steps(self) -> int:
        """Number of times that the other side has set its clock."""
        return self._estimator.clock_steps

    def offset(self, now_us: int) -> ClockOffset:
        """Return the clock that the process follows, its offset and its error bound."""
        reading = self._estimator.read(now_us) if self.active else None
        return reading or SHARED_CLOCK

    def on_plan_sent(self, sequence: int, m_us: int) -> None:
        """Note that the plan of this sequence number is sent at ``m_us``."""
        self._sent_us[sequence] = m_us
        while len(self._sent_us) > MAX_PENDING_PLANS:
            self._sent_us.popitem(last=False)

    def check_stamp(self, signal: Message, m_us: int) -> str:
        """Add an input that arrived at ``m_us``. Return why it is rejected; empty if it is accepted."""
        if not isinstance(signal, STAMPED_INPUTS) or (self._clock.newest is not None and not self.active):
            return ""  # an announced clock stamps all messages, and may run at another speed
        if self._first_us is None:
            self._first_us = m_us
        clock_steps = self.clock_steps
        if not self._estimator.add_stamp(signal.t_ns, m_us):
            return "t_ns contradicts the clock of all earlier stamps"
        if self.active and self.clock_steps > clock_steps:
            self._clock.reset()
        if isinstance(signal, Applied) and signal.plan_epoch == self._epoch and signal.plan_sequence in self._sent_us:
            self._estimator.add_receipt(signal.plan_received_t_ns, self._sent_us[signal.plan_sequence])
        self._set(m_us, self._first_us)
        return ""

    def _set(self, m_us: int, first_us: int) -> None:
        reading = self._estimator.read(m_us)
        if m_us - first_us < GRACE_US or reading is None:
            return
        self.active = True
        self._clock.set_segment(ClockSegment(m_us, m_us * 1000 + reading.offset_ns, 1, 1, ClockState.RUNNING))
