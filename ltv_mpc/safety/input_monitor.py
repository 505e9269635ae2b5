"""Monitoring of one input: order and source of its messages, their period, and whether they are up to date.

    alive    a message was received recently
    valid    the stamp of the newest message is close to the receiver's time
    rate     at most half of the recent messages are missing, by the median spacing of their stamps

Times are those of the receiver, whose clock follows the monotonic clock of its host. A jump of the wall clock has no
effect.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

from ltv_mpc.node import ReceivedMessage
from ltv_mpc.safety.health import DEFAULT_AGES, DEGRADED_PERIODS, MAX_STAMP_AHEAD_NS, Ages, timeout_ns

SPACINGS = 9
"""Number of spacings in the median, so that a lost message or a burst does not change the period."""

MAX_MEAN_OVER_MEDIAN = 2.0
"""Ratio of mean to median spacing above which ``rate`` is false: more than half of the messages are missing."""

CLOCK_SET_BACK_NS = 10_000_000_000
"""Step backwards between two stamps from which the sender's clock counts as set back."""

CONTESTED_NS = 1_500_000_000
"""Time for which a second source is reported after both have published."""

SECOND_SOURCE = "second source"
"""Begin of the reason for which message validation rejects a frame of a second source."""


class Period:
    """Spacing between successive stamps of one kind of message."""

    def __init__(self) -> None:
        self.last_ns: int | None = None
        """Newest stamp (ns); None before the first."""
        self._spacings: deque[int] = deque(maxlen=SPACINGS)
        self._median_ns: int | None = 0  # None: not computed since the last stamp

    def add(self, t_ns: int) -> None:
        """Add the stamp of a message, newer than the last.

        Parameters
        ----------
        t_ns : stamp (ns).
        """
        if self.last_ns is not None:
            self._spacings.append(max(t_ns - self.last_ns, 0))
            self._median_ns = None
        self.last_ns = t_ns

    @property
    def median_ns(self) -> int:
        """Median spacing (ns); 0 before the second stamp."""
        if self._median_ns is None:
            self._median_ns = sorted(self._spacings)[len(self._spacings) // 2]
        return self._median_ns

    @property
    def mean_ns(self) -> float:
        """Mean spacing (ns); 0 before the second stamp."""
        return sum(self._spacings) / len(self._spacings) if self._spacings else 0.0


class InputState(NamedTuple):
    """State of one input at one time."""

    alive: bool
    valid: bool
    rate: bool
    age_ns: int | None  # age of the newest message by its stamp; None before the first
    period_ns: int  # median spacing of the stamps; 0 before the second


class InputMonitor:
    """Order and timeliness of one input.

    A source is identified by its epoch, which each start of a process draws at random.
    """

    def __init__(self) -> None:
        self.rejected = 0
        """Number of messages rejected: out of order, or stamped too far ahead of their arrival."""
        self.period = Period()
        self._epoch: int | None = None
        self._sequence = -1
        self._stamp_ns: int | None = None
        self._received_ns = 0
        self._second = ""  # reason of the last rejection of a second source
        self._unanswered = False  # no message was accepted since
        self._contested_ns: int | None = None  # last time at which both published

    def reject(self, why: str) -> None:
        """Note a message that validation has rejected before it came here; only those of a second source count.

        Parameters
        ----------
        why : reason of the rejection.
        """
        if why.startswith(SECOND_SOURCE):
            self._second, self._unanswered = why, True

    def second_source(self, t_ns: int) -> str:
        """Return the reason of the last rejection if a second source publishes beside the accepted one, else "".

        Parameters
        ----------
        t_ns : current time (ns).
        """
        contested = self._contested_ns is not None and t_ns - self._contested_ns <= CONTESTED_NS
        return self._second if contested else ""

    def accepts(self, received: ReceivedMessage, stamp_ns: int) -> bool:
        """Return True if an entry of an inbox is accepted as the newest one: ``receive``.

        Parameters
        ----------
        received : its header and its arrival count.
        stamp_ns : time of validity of its message (ns).
        """
        at_ns = received.received_t_ns
        return self.receive(epoch=received.epoch, sequence=received.sequence, stamp_ns=stamp_ns, received_ns=at_ns)

    def receive(self, *, epoch: int, sequence: int, stamp_ns: int, received_ns: int) -> bool:
        """Return True if a message is accepted as the newest one.

        It must be later than the last one of its source, or of another source; not stamped before the newest message,
        unless by more than ``CLOCK_SET_BACK_NS``; and not stamped more than ``MAX_STAMP_AHEAD_NS`` after its arrival.

        Parameters
        ----------
        epoch, sequence : header of the message.
        stamp_ns : time of validity of the message (ns).
        received_ns : time of its arrival (ns).
        """
        if stamp_ns > received_ns + MAX_STAMP_AHEAD_NS:
            self.rejected += 1
            return False
        same = epoch == self._epoch
        older_ns = 0 if self._stamp_ns is None else self._stamp_ns - stamp_ns
        set_back = older_ns > CLOCK_SET_BACK_NS
        if (same and sequence <= self._sequence) or (older_ns > 0 and not set_back):
            self.rejected += 1
            return False
        if set_back:
            self.period = Period()
        if self._stamp_ns is None or older_ns != 0:
            self.period.add(stamp_ns)
        self._epoch, self._sequence, self._stamp_ns, self._received_ns = epoch, sequence, stamp_ns, received_ns
        if self._unanswered:
            self._unanswered, self._contested_ns = False, received_ns
        return True

    def restart(self) -> None:
        """Begin with another source: its order and its period are its own. The count of rejected messages stays."""
        self.period, self._epoch, self._sequence, self._stamp_ns = Period(), None, -1, None

    def silent_ns(self, t_ns: int) -> int | None:
        """Return the time (ns) since the newest message arrived; None before the first.

        Parameters
        ----------
        t_ns : current time (ns).
        """
        return None if self._stamp_ns is None else t_ns - self._received_ns

    def state_at(self, t_ns: int, ages: Ages = DEFAULT_AGES) -> InputState:
        """Return the state of the input.

        Parameters
        ----------
        t_ns : current time (ns).
        ages : thresholds; ``degraded_s`` is the shortest timeout.
        """
        period_ns = self.period.median_ns
        if self._stamp_ns is None:
            return InputState(False, False, False, None, period_ns)
        timeout = timeout_ns(DEGRADED_PERIODS, period_ns, ages.degraded_s)
        age_ns = t_ns - self._stamp_ns
        return InputState(
            alive=t_ns - self._received_ns <= timeout,
            valid=abs(age_ns) <= timeout,
            rate=self.period.mean_ns <= MAX_MEAN_OVER_MEDIAN * period_ns,
            age_ns=age_ns,
            period_ns=period_ns,
        )
