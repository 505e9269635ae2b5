"""How well the inputs keep up: a pure function of ages, all in the vehicle's time.

    degraded   the newest estimate is older than max(3 periods, 0.5 s), or there is none
    nominal    else

A pause of the clock freezes every age; a slow publisher is measured by its own period.
"""

from __future__ import annotations

from collections import deque

from ltv_mpc.signals import Health

PERIODS = 3
LEAST_NS = 500_000_000

REMEMBERED = 9
"""Spacings of which the period is the median: one that was lost, or came in a burst, does not move it."""


def health(*, age_ns: int | None, period_ns: int) -> Health:
    """By the age of the newest estimate (None: there is none) and the period at which estimates come (0: not known)."""
    if age_ns is None or age_ns > max(PERIODS * period_ns, LEAST_NS):
        return Health.DEGRADED
    return Health.NOMINAL


class Period:
    """The time between two estimates, as their stamps have it."""

    def __init__(self) -> None:
        self._last_ns: int | None = None
        self._spacings: deque[int] = deque(maxlen=REMEMBERED)

    def stamped(self, t_ns: int) -> None:
        """One more, newer than the last."""
        if self._last_ns is not None:
            self._spacings.append(max(t_ns - self._last_ns, 0))
        self._last_ns = t_ns

    @property
    def median_ns(self) -> int:
        """0 before the second."""
        return sorted(self._spacings)[len(self._spacings) // 2] if self._spacings else 0
