"""Age of one input: its newest stamp, the arrival of that message, and the spacing of the stamps.

Whatever depends on how old an input is has one: the monitor of an input, the choice of a source, the gates of estimates
and plans, and the mission policy. Times are those of the receiver, whose clock follows the monotonic clock of its host.
A jump of the wall clock has no effect.
"""

from __future__ import annotations

from collections import deque
from typing import Generic, TypeVar

SPACINGS = 9
"""Number of spacings in the median, so that a lost message or a burst does not change the period."""

CONTESTED_NS = 1_500_000_000
"""Time for which a second source is reported after both have published."""

T = TypeVar("T")


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


class Contest(Generic[T]):
    """Second source of an input, which is reported while both publish."""

    def __init__(self) -> None:
        self._second: T | None = None
        self._unanswered = False  # nothing was accepted since
        self._at_ns: int | None = None  # last time at which both published

    def reject(self, second: T) -> None:
        """Note a message of a second source.

        Parameters
        ----------
        second : what identifies the source.
        """
        self._second, self._unanswered = second, True

    def accept(self, t_ns: int) -> None:
        """Note a message of the source in use.

        Parameters
        ----------
        t_ns : its arrival (ns).
        """
        if self._unanswered:
            self._unanswered, self._at_ns = False, t_ns

    def second(self, t_ns: int) -> T | None:
        """Return the second source if it publishes beside the one in use.

        Parameters
        ----------
        t_ns : current time (ns).
        """
        return self._second if self._at_ns is not None and t_ns - self._at_ns <= CONTESTED_NS else None
