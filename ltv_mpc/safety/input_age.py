"""Age and monitor of one input: its newest stamp, the arrival of that message, the spacing of the stamps, its source.

Whatever depends on how old an input is has one: the monitor of an input, the choice of a source, the gates of estimates
and plans, and the mission policy. Times are those of the receiver, whose clock follows the monotonic clock of its host.
A jump of the wall clock has no effect.

A monitor checks order and source of the messages, and publishes:

alive    a message was received recently
valid    the stamp of the newest message is close to the receiver's time
rate     at most half of the recent messages are missing, by the median spacing of their stamps
"""

from __future__ import annotations

from collections import deque

from ltv_mpc.messages import InputReport
from ltv_mpc.node import ReceivedMessage
from ltv_mpc.safety.health import DEFAULT_AGES, DEGRADED_PERIODS, MAX_STAMP_AHEAD_NS, Ages, timeout_ns

SPACINGS = 9
"""Number of spacings in the median, so that a lost message or a burst does not change the period."""


class InputAge:
    """Newest message of an input by its stamp and its arrival, and the period of the input."""

    def __init__(self) -> None:
        self.stamp_ns: int | None = None
        """Newest stamp (ns); None before the first."""
        self.arrived_ns = 0
        """Arrival of that message (ns)."""
        self._spacings: deque[int] = deque(maxlen=SPACINGS)
        self._median_ns: int | None = 0  # None: not computed since the last stamp

    def add(self, stamp_ns: int, arrived_ns: int | None = None) -> None:
        """Add a message. A repeated stamp changes the arrival alone.

        Parameters
        ----------
        stamp_ns : stamp (ns).
        arrived_ns : arrival (ns); None: the stamp is that of the arrival.
        """
        if self.stamp_ns not in (None, stamp_ns):
            self._spacings.append(max(stamp_ns - self.stamp_ns, 0))
            self._median_ns = None
        self.stamp_ns, self.arrived_ns = stamp_ns, stamp_ns if arrived_ns is None else arrived_ns

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

    def silent_ns(self, t_ns: int) -> int | None:
        """Return the time (ns) since the newest message arrived; None before the first.

        Parameters
        ----------
        t_ns : current time (ns).
        """
        return None if self.stamp_ns is None else t_ns - self.arrived_ns


MAX_MEAN_OVER_MEDIAN = 2.0
"""Ratio of mean to median spacing above which ``rate`` is false: more than half of the messages are missing."""

CLOCK_SET_BACK_NS = 10_000_000_000
"""Step backwards between two stamps from which the sender's clock counts as set back."""


class InputMonitor:
    """Order and timeliness of one input.

    A source is identified by its epoch, which each start of a process draws at random.
    """

    def __init__(self) -> None:
        self.rejected = 0
        """Number of messages rejected: out of order, or stamped too far ahead of their arrival."""
        self.age = InputAge()
        """Age of the newest message."""
        self._epoch: int | None = None
        self._sequence = -1

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
        older_ns = 0 if self.age.stamp_ns is None else self.age.stamp_ns - stamp_ns
        set_back = older_ns > CLOCK_SET_BACK_NS
        if (same and sequence <= self._sequence) or (older_ns > 0 and not set_back):
            self.rejected += 1
            return False
        if set_back:
            self.age = InputAge()
        self.age.add(stamp_ns, received_ns)
        self._epoch, self._sequence = epoch, sequence
        return True

    def restart(self) -> None:
        """Begin with another source: its order and its period are its own. The count of rejected messages stays."""
        self.age, self._epoch, self._sequence = InputAge(), None, -1

    def report(self, name: str, t_ns: int, ages: Ages = DEFAULT_AGES, *, implausible: int = 0) -> InputReport:
        """Return the state of the input.

        Parameters
        ----------
        name : key of the input.
        t_ns : current time (ns).
        ages : thresholds; ``degraded_s`` is the shortest timeout.
        implausible : messages that were rejected later.
        """
        age, period_ns, silent_ns = self.age, self.age.median_ns, self.age.silent_ns(t_ns)
        timeout = timeout_ns(DEGRADED_PERIODS, period_ns, ages.degraded_s)
        age_ns = None if age.stamp_ns is None else t_ns - age.stamp_ns
        return InputReport(
            input=name,
            alive=silent_ns is not None and silent_ns <= timeout,
            valid=age_ns is not None and abs(age_ns) <= timeout,
            rate=age_ns is not None and age.mean_ns <= MAX_MEAN_OVER_MEDIAN * period_ns,
            age_ns=age_ns,
            period_ns=period_ns,
            rejected=self.rejected + implausible,
        )
