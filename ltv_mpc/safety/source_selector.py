"""Source selector: of several sources on one key, choose the one whose messages are used.

A source is identified by its epoch, which each start of a publisher draws at random. With T the median period of the
active source:

    silence     no believed message of the active source for max(3 T, 0.5 s), at most 1.5 s
    candidate   another source, with an unbroken run of believed messages that agree with the prediction

The first believed message makes its source active. The active source stays until its silence; then a candidate takes
over once its run has five messages over at least 0.5 s. All other sources are rejected and none is excluded for ever. A
short period gains nothing, because the run and the silence both last 0.5 s.

The caller decides what is believed and what agrees. Time is that of the arrival of the messages.
"""

from __future__ import annotations

from ltv_mpc.safety.health import DEGRADED_PERIODS
from ltv_mpc.safety.input_monitor import Period

MIN_SILENCE_NS, MAX_SILENCE_NS = 500_000_000, 1_500_000_000
"""Bounds of the silence after which the active source may be replaced."""

RUN_MESSAGES, RUN_NS = 5, 500_000_000
"""Length of a candidate's run before it takes over."""

MAX_GAP_NS = 10_000_000_000
"""Gap after which a candidate's run starts again. It also does if the time is set back."""

MAX_CANDIDATES = 64
"""Number of sources whose runs are remembered; beyond it the one that was silent longest is forgotten."""

REPORTED_NS = 1_500_000_000
"""Time for which a second source is reported after both sources have published."""


class _Run:
    """Run of believed and agreeing messages of one candidate."""

    __slots__ = ("first_ns", "last_ns", "messages")

    def __init__(self, t_ns: int) -> None:
        self.first_ns = self.last_ns = t_ns
        self.messages = 0

    def add(self, t_ns: int) -> bool:
        """Add a message. Return True if the run is long enough to take over."""
        if not 0 <= t_ns - self.last_ns <= MAX_GAP_NS:
            self.first_ns, self.messages = t_ns, 0
        self.last_ns = t_ns
        self.messages += 1
        return self.messages >= RUN_MESSAGES and t_ns - self.first_ns >= RUN_NS


class SourceSelector:
    """Choice of the active source of one key."""

    def __init__(self) -> None:
        """Begin without a source."""
        self.active: int | None = None
        """Source whose messages are used; None before the first believed message."""
        self.rejected = 0
        """Number of messages of other sources."""
        self.second: int | None = None
        """Source whose message was rejected last."""
        self._period = Period()
        self._believed_ns = 0  # last believed message of the active source
        self._unanswered = False  # a message was rejected since
        self._contested_ns: int | None = None  # last time at which both published
        self._runs: dict[int, _Run] = {}

    def receive(self, source: int, t_ns: int, *, believed: bool, agrees: bool) -> bool:
        """Return True if the source of a message is active, also if the message made it so.

        Parameters
        ----------
        source : source of the message.
        t_ns : time of arrival (ns).
        believed : the message passes the checks that need no other source.
        agrees : the message agrees with the prediction; ignored for the active source.
        """
        self._believed_ns = min(self._believed_ns, t_ns)  # later than now only if the time was set back
        if source == self.active or (self.active is None and believed):
            if believed:
                self._use(source, t_ns)
            return True
        if self.active is None:
            return False
        if self._candidate_takes_over(source, t_ns, agrees=believed and agrees):
            self._use(source, t_ns)
            return True
        self.rejected += 1
        self.second, self._unanswered = source, True
        return False

    def silent_ns(self, t_ns: int) -> int | None:
        """Return the time (ns) since the last believed message of the active source; None without one.

        Parameters
        ----------
        t_ns : current time (ns).
        """
        return None if self.active is None else t_ns - self._believed_ns

    def contested(self, t_ns: int) -> bool:
        """Return True if a second source publishes beside the active one.

        Parameters
        ----------
        t_ns : current time (ns).
        """
        return self._contested_ns is not None and t_ns - self._contested_ns <= REPORTED_NS

    def _use(self, source: int, t_ns: int) -> None:
        """Record a believed message of the source that is active from now on."""
        if source != self.active:
            self.active, self._period = source, Period()
            self._runs.pop(source, None)
        elif self._unanswered:
            self._contested_ns = t_ns
        self._unanswered = False
        self._period.add(t_ns)
        self._believed_ns = t_ns

    def _candidate_takes_over(self, source: int, t_ns: int, *, agrees: bool) -> bool:
        run = self._runs.pop(source, None) or _Run(t_ns)
        if not agrees:
            return False
        long_enough = run.add(t_ns)
        self._runs[source] = run  # now the last one to be forgotten
        if len(self._runs) > MAX_CANDIDATES:
            del self._runs[next(iter(self._runs))]
        return long_enough and t_ns - self._believed_ns >= self._silence_ns

    @property
    def _silence_ns(self) -> int:
        return min(max(DEGRADED_PERIODS * self._period.median_ns, MIN_SILENCE_NS), MAX_SILENCE_NS)
