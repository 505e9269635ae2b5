"""When a node's next step is due, by vehicle time.

A grid skips nothing: t = k x period. A cycle starts at its period, or when the last one ended, if that is later. Both
begin at the first multiple of the period that is not before the start, as in lock step.
"""

from __future__ import annotations

from ltv_mpc.node import Cycle, Grid, OnMessage, Schedule


class StepSchedule:
    """``next_ns`` is None while it is not known: before the clock was heard, or for ever where messages decide."""

    def __init__(self, schedule: Schedule, *, end_ns: int | None = None) -> None:
        self._period_ns = 0 if isinstance(schedule, OnMessage) else schedule.period_ns
        self._may_shift = isinstance(schedule, Cycle)
        self._end_ns = end_ns
        self.on_grid = isinstance(schedule, Grid)
        self.next_ns: int | None = None

    def start(self, now_ns: int, *, phase_ns: int = 0) -> None:
        """The clock was heard for the first time. Cycles start ``phase_ns`` after the multiples of their period."""
        if self._period_ns and self.next_ns is None:
            self.next_ns = -(-now_ns // self._period_ns) * self._period_ns
            if self._may_shift:
                self.next_ns += min(phase_ns, self._period_ns // 2)

    def reset(self) -> None:
        """The clock was set: the next step is not known until it is heard again."""
        self.next_ns = None

    def advance(self, ended_ns: int) -> None:
        """The step that was due is done, its outputs are out; the clock reads ``ended_ns``."""
        if self.next_ns is None:
            return
        self.next_ns += self._period_ns
        if self._may_shift:
            self.next_ns = max(self.next_ns, ended_ns)

    @property
    def finished(self) -> bool:
        """Whether the last step is done."""
        return self._end_ns is not None and self.next_ns is not None and self.next_ns > self._end_ns
