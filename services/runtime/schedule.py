"""Step schedule: the vehicle time at which a node's next step is due.

    Grid        every multiple of the period, none is skipped: t = k x period
    Cycle       the last start plus the period, or the end of the last step if that is later
    OnMessage   no schedule: messages cause the steps

Steps of a Grid are carried out in batches of ``BATCH_NS``: each waits for the last one of its batch.
Grid and Cycle begin at the first multiple of the period that is not before the start, as in lock step.
"""

from __future__ import annotations

from ltv_mpc.node import Cycle, Grid, OnMessage, Schedule

BATCH_NS = 50_000_000
"""Vehicle time of the steps on a grid that are carried out and published together. The estimator's period is a multiple
of it, so no estimate waits for the end of a batch."""


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

    def batch_end_ns(self, speed: float) -> int | None:
        """Return the time of the last step that is carried out together with the next one; None if none is due.

        Steps on a grid are carried out in batches of ``BATCH_NS``; below real time, of as much wall time. ``speed``:
        vehicle seconds per second. A batch ends at a multiple of its length: an input that is due then is not delayed.
        """
        next_ns = self.next_ns
        steps = int(BATCH_NS * min(1.0, speed)) // self._period_ns if self.on_grid else 1
        if next_ns is None or steps <= 1:
            return next_ns
        length_ns = steps * self._period_ns
        end_ns = -(-next_ns // length_ns) * length_ns
        return (
            end_ns if self._end_ns is None else max(next_ns, min(end_ns, self._end_ns - self._end_ns % self._period_ns))
        )

    @property
    def finished(self) -> bool:
        """True once the last step is done."""
        return self._end_ns is not None and self.next_ns is not None and self.next_ns > self._end_ns
