"""When a fault lasts: from its start, included, to its end, excluded. Vehicle time."""

from __future__ import annotations

from typing import NamedTuple


class Interval(NamedTuple):
    """[start_ns, end_ns)."""

    start_ns: int
    end_ns: int

    def contains(self, t_ns: int) -> bool:
        """Whether it lasts at ``t_ns``."""
        return self.start_ns <= t_ns < self.end_ns
