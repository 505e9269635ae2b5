"""Interval of vehicle time in which a fault is active."""

from __future__ import annotations

from typing import NamedTuple


class Interval(NamedTuple):
    """Half-open interval [start_ns, end_ns) of vehicle time."""

    start_ns: int
    end_ns: int

    def contains(self, t_ns: int) -> bool:
        """Return True if ``t_ns`` lies in the interval."""
        return self.start_ns <= t_ns < self.end_ns
