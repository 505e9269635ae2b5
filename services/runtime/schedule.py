"""Step schedule: the vehicle time at which a node's next step is due.

    Grid        every multiple of the period, none is skipped: t = k x period
    Cycle       the last start plus the period, or the end of the last step if that is later
    OnMessage   no schedule: messages cause the steps

Grid and Cycle begin at the first multiple of the period that is not before the start, as in lock step.
"""

from __future__ import annotations

from ltv_mpc.node import Cycle, Grid, OnMessage, Schedule


class StepSchedule:
    """Schedule of one node. ``next_ns`` is None before the clock is known, and always for OnMessage."""

    def __init__(self, schedule: Schedule, *, end_ns: int | None = None) -> None:
        self._period_ns = 0 if isinstance(schedule, OnMessage) else schedule.period_ns
        self._may_shift = isinstance(schedule, Cycle)
        self._end_ns = end_ns
        self.on_grid = isinstance(schedule, Grid)
        self.next_ns: int | None = None

    def start(self, now_ns: int, *, phase_ns: int = 0) -> None:
        """Start at the first clock reading. Cycles start ``phase_ns`` after the multiples of their period."""
        if self._period_ns and self.next_ns is None:
            self.next_ns = -(-now_ns // self._period_ns) * self._period_ns
            if self._may_shift:
                self.next_ns += min(phase_ns, self._period_ns // 2)

    def advance(self, ended_ns: int) -> None:
        """Schedule the next step after one that ended at ``ended_ns``."""
        if self.next_ns is None:
            return
        self.next_ns += self._period_ns
        if self._may_shift:
            self.next_ns = max(self.next_ns, ended_ns)

    @property
    def finished(self) -> bool:
        """True once the last step is done."""
        return self._end_ns is not None and self.next_ns is not None and self.next_ns > self._end_ns
