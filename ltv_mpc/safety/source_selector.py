"""Source selector: of several sources of one input, choose the one whose messages are used.

A source is one start of a publisher: its name, by the key on which it publishes, and its epoch, which each start draws
at random. With T the median period of the active source:

    silence     no believed message of the active source for max(3 T, 0.5 s), at most 1.5 s
    run         successive believed messages of another source, at least five over at least 0.5 s, that agree with the
                prediction, or that are consistent with each other

The first believed message makes its source active. Another source takes over

    after the silence                 with a run that agrees with the prediction
    after 10 s of silence             with a consistent run
    from a source of lower order      with a run of 5 s that agrees with the prediction
    if its name is forced             with a consistent run

All other messages are rejected, and no source is excluded for ever. A short period gains nothing, because each run has
a smallest duration. The caller decides what is believed, consistent and in agreement. Time is that of arrival.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from ltv_mpc.bounded import remember
from ltv_mpc.safety.health import DEGRADED_PERIODS
from ltv_mpc.safety.input_age import InputAge

MIN_SILENCE_NS, MAX_SILENCE_NS = 500_000_000, 1_500_000_000
"""Bounds of the silence after which the active source may be replaced."""

PREDICTION_NS = 10_000_000_000
"""Silence after which the prediction does not count any more."""

RUN_MESSAGES, RUN_NS = 5, 500_000_000
"""Length of a run after which its source may take over."""

RETURN_NS = 5_000_000_000
"""Duration of the run after which a source of higher order takes over from one that is not silent."""

CONTESTED_NS = 1_500_000_000
"""Time for which a second source is reported after both have published."""

MAX_GAP_NS = 10_000_000_000
"""Gap after which a run begins again. It also does if the time is set back."""


class Source(NamedTuple):
    """One start of a publisher."""

    name: str
    epoch: int

    def __str__(self) -> str:
        return f"{self.name}, epoch {self.epoch}"


class Judgement(NamedTuple):
    """Judgement of one message of a source that is not active."""

    believed: bool
    """The message passes all checks that need no other source."""
    consistent: bool
    """The message agrees with the one before it of its source."""
    agrees: bool
    """The message agrees with the prediction."""


class _Run:
    """Unbroken run of messages of one source."""

    def __init__(self) -> None:
        self.first_ns = self.last_ns = self.messages = 0

    def add(self, t_ns: int, *, fits: bool) -> None:
        """Add a message; one that does not fit ends the run.

        Parameters
        ----------
        t_ns : time of arrival (ns).
        fits : the message belongs to the run.
        """
        if not fits or not 0 <= t_ns - self.last_ns <= MAX_GAP_NS:
            self.messages = 0
        if not self.messages:
            self.first_ns = t_ns
        self.last_ns = t_ns
        self.messages += fits

    def lasts(self, duration_ns: int) -> bool:
        """Return True if the run has RUN_MESSAGES over at least ``duration_ns``.

        Parameters
        ----------
        duration_ns : smallest duration (ns).
        """
        return self.messages >= RUN_MESSAGES and self.last_ns - self.first_ns >= duration_ns


class SourceSelector:
    """Choice of the active source of one input."""

    def __init__(self, order: Sequence[str] = ()) -> None:
        """Begin without a source.

        Parameters
        ----------
        order : names of the sources, the preferred one first; other names come last.
        """
        self.active: Source | None = None
        """Source whose messages are used; None before the first believed message."""
        self.rejected = 0
        """Number of messages of other sources that have the active one's name."""
        self.forced = ""
        """Name that an operator has put before all others; empty if none."""
        self._order = {name: place for place, name in enumerate(order)}
        self._age = InputAge()  # of the believed messages of the active source, by their arrival
        self._candidates: dict[Source, tuple[_Run, _Run]] = {}  # consistent messages, and those that agree besides
        self._second: Source | None = None  # of the active one's name
        self._unanswered = False  # nothing of the active source was believed since the last message of the second one
        self._contested_ns: int | None = None  # last time at which both published
        self._heard_ns: dict[str, int] = {}  # last believed message by name

    def believe(self, source: Source, t_ns: int) -> None:
        """Record a believed message of the active source, or of the first one.

        Parameters
        ----------
        source, t_ns : source and time of arrival (ns) of the message.
        """
        if source != self.active:
            self.active, self._age = source, InputAge()
            self._unanswered, self._contested_ns = False, None
            self._candidates.pop(source, None)
        if self._unanswered:
            self._unanswered, self._contested_ns = False, t_ns
        self._age.add(t_ns)
        remember(self._heard_ns, source.name, t_ns)

    def offer(self, source: Source, t_ns: int, judgement: Judgement) -> bool:
        """Return True if another source takes over with this message; then it is the active one.

        Parameters
        ----------
        source, t_ns : source and time of arrival (ns) of the message.
        judgement : of the message.
        """
        assert self.active is not None
        self._age.arrived_ns = min(self._age.arrived_ns, t_ns)  # later than now only if the time was set back
        consistent, agreeing = candidate = self._candidates.pop(source, None) or (_Run(), _Run())
        consistent.add(t_ns, fits=judgement.believed and judgement.consistent)
        agreeing.add(t_ns, fits=all(judgement))
        if judgement.believed:
            remember(self._heard_ns, source.name, t_ns)
            if self._takes_over(source, candidate, self.active, t_ns - self._age.arrived_ns):
                self.believe(source, t_ns)
                return True
        remember(self._candidates, source, candidate)
        if source.name == self.active.name:
            self.rejected += 1
            self._second, self._unanswered = source, True
        return False

    def second(self, t_ns: int) -> Source | None:
        """Return the second source of the active one's name, if both publish.

        Parameters
        ----------
        t_ns : current time (ns).
        """
        recently = self._contested_ns is not None and t_ns - self._contested_ns <= CONTESTED_NS
        return self._second if recently else None

    def force(self, name: str, t_ns: int) -> str:
        """Put a name before all others; its source takes over. Return why this is rejected; empty if it is not.

        Parameters
        ----------
        name : name of a source; empty: the order of the settings again.
        t_ns : current time (ns).
        """
        heard = [known for known, at_ns in self._heard_ns.items() if 0 <= t_ns - at_ns <= PREDICTION_NS]
        if name and name not in heard:
            return f"no valid message of source {name} in the last 10 s; sources: {', '.join(sorted(heard)) or 'none'}"
        self.forced = name
        return ""

    def _takes_over(self, source: Source, candidate: tuple[_Run, _Run], active: Source, silent_ns: int) -> bool:
        """Return True by one of the four conditions in the module docstring."""
        consistent, agreeing = candidate
        if source.name == self.forced != active.name or silent_ns > PREDICTION_NS:
            return consistent.lasts(RUN_NS)
        if self._place(source) < self._place(active) and agreeing.lasts(RETURN_NS):
            return True
        return silent_ns >= self._silence_ns and agreeing.lasts(RUN_NS)

    def _place(self, source: Source) -> int:
        """Return the place of a source in the order."""
        return -1 if source.name == self.forced else self._order.get(source.name, len(self._order))

    @property
    def _silence_ns(self) -> int:
        return min(max(DEGRADED_PERIODS * self._age.median_ns, MIN_SILENCE_NS), MAX_SILENCE_NS)
