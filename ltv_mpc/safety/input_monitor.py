"""What a receiver knows of one input: alive, valid, in time; its source, order and period.

    alive    it was heard lately
    valid    what was heard last is of now, by its own stamp
    rate     of what came lately no more than half was missing, by the median spacing

Times are the receiver's: its clock runs by the monotonic one of its machine, so a jump of the wall's changes nothing.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

from ltv_mpc.safety.health import DEFAULT_AGES, DEGRADED_PERIODS, Ages, timeout_ns

REMEMBERED = 9
"""Spacings of which the period is the median: one that was lost, or came in a burst, does not move it."""

MOST_MISSING = 2.0
"""Mean spacing over the median one, beyond which the rate is not kept."""

SET_BACK_NS = 10_000_000_000
"""A stamp that is so much older than the one before means that the sender's clock was set back."""

AHEAD_NS = 1_000_000_000
"""What is stamped further ahead of its arrival is of a clock that has jumped; believed, it would make all that is true
look old until its time has come. Another computer's clock is known to half a second while it is first heard through
delays that jump.
"""


class Period:
    """The time between two messages of a kind."""

    def __init__(self) -> None:
        self._last_ns: int | None = None
        self._spacings: deque[int] = deque(maxlen=REMEMBERED)
        self._median_ns: int | None = 0  # None: not worked out since the last

    def add(self, t_ns: int) -> None:
        """One more, newer than the last."""
        if self._last_ns is not None:
            self._spacings.append(max(t_ns - self._last_ns, 0))
            self._median_ns = None
        self._last_ns = t_ns

    @property
    def median_ns(self) -> int:
        """0 before the second."""
        if self._median_ns is None:
            self._median_ns = sorted(self._spacings)[len(self._spacings) // 2]
        return self._median_ns

    @property
    def mean_ns(self) -> float:
        """0 before the second."""
        return sum(self._spacings) / len(self._spacings) if self._spacings else 0.0


class InputState(NamedTuple):
    """Of one input, at one time."""

    alive: bool
    valid: bool
    rate: bool
    age_ns: int | None  # of what was heard last, by its stamp; None before the first
    period_ns: int  # median spacing of the stamps; 0 before the second


class InputMonitor:
    """One input: who sends it, in which order, and when it was heard last."""

    def __init__(self) -> None:
        self.rejected = 0
        """Messages that came after a newer one, or are stamped later than they came: not read."""
        self.period = Period()
        self._epoch: int | None = None
        self._sequence = -1
        self._stamp_ns: int | None = None
        self._received_ns = 0

    def receive(self, *, epoch: int, sequence: int, stamp_ns: int, received_ns: int) -> bool:
        """Whether a message is news: the next of its source, or the first of another, and of a later time, not of one
        that is still to come.

        A source is known by its epoch, which each start of a process draws anew.
        """
        if stamp_ns > received_ns + AHEAD_NS:
            self.rejected += 1
            return False
        same = epoch == self._epoch
        older_ns = 0 if self._stamp_ns is None else self._stamp_ns - stamp_ns
        set_back = older_ns > SET_BACK_NS
        if (same and sequence <= self._sequence) or (older_ns > 0 and not set_back):
            self.rejected += 1
            return False
        if set_back:
            self.period = Period()
        if self._stamp_ns is None or older_ns != 0:
            self.period.add(stamp_ns)
        self._epoch, self._sequence, self._stamp_ns, self._received_ns = epoch, sequence, stamp_ns, received_ns
        return True

    def silent_ns(self, t_ns: int) -> int | None:
        """How long ago it was heard; None before the first."""
        return None if self._stamp_ns is None else t_ns - self._received_ns

    def state_at(self, t_ns: int, ages: Ages = DEFAULT_AGES) -> InputState:
        """What is to be said of it at ``t_ns``."""
        period_ns = self.period.median_ns
        if self._stamp_ns is None:
            return InputState(False, False, False, None, period_ns)
        patience = timeout_ns(DEGRADED_PERIODS, period_ns, ages.degraded_s)
        age_ns = t_ns - self._stamp_ns
        return InputState(
            alive=t_ns - self._received_ns <= patience,
            valid=abs(age_ns) <= patience,
            rate=self.period.mean_ns <= MOST_MISSING * period_ns,
            age_ns=age_ns,
            period_ns=period_ns,
        )
