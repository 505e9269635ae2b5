"""Queue of a process's periodic duties: status, heartbeat, controller status and clock announcement.

Each duty keeps the time at which it is due next, because events can bring it forward: a node that falls behind reports
earlier, and a change of the clock is announced at once.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple


class Deadline(NamedTuple):
    """Periodic duty: when it is due and the function that does it."""

    due_us: Callable[[], int | None]
    """Return the monotonic time in microseconds at which the duty is due; None if it never is."""
    run: Callable[[int], None]
    """Do the duty, given the monotonic time in microseconds; it sets its next due time."""


class DeadlineQueue:
    """Deadlines of one event loop, run in the order in which they were added when several are due."""

    def __init__(self) -> None:
        self._deadlines: list[Deadline] = []

    def add(self, due_us: Callable[[], int | None], run: Callable[[int], None]) -> None:
        """Add a duty."""
        self._deadlines.append(Deadline(due_us, run))

    def run_due(self, now_us: int) -> None:
        """Run every duty whose deadline has passed."""
        for deadline in self._deadlines:
            due_us = deadline.due_us()
            if due_us is not None and now_us >= due_us:
                deadline.run(now_us)

    def next_us(self, step_due_us: int | None = None) -> int:
        """Return the earliest deadline, or the time of the next step if that is earlier."""
        dues = [step_due_us, *(deadline.due_us() for deadline in self._deadlines)]
        return min(due_us for due_us in dues if due_us is not None)
