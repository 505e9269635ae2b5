"""Queue of a process's periodic duties: status, heartbeat, controller status and clock announcement.

Each duty keeps the time at which it is due next, because events can bring it forward: a node that falls behind reports
earlier, and a change of the clock is announced at once.
"""

from __future__ import annotations

from collections.abc import Callable


class DeadlineQueue:
    """Deadlines of one event loop, run in the order in which they were added when several are due."""

    def __init__(self) -> None:
        self._deadlines: list[tuple[Callable[[], int | None], Callable[[int], None]]] = []

    def add(self, due_us: Callable[[], int | None], run: Callable[[int], None]) -> None:
        """Add a duty.

        ``due_us`` returns the monotonic time in microseconds at which it is due, None if it never is; ``run`` does it,
        given the monotonic time in microseconds, and sets its next due time.
        """
        self._deadlines.append((due_us, run))

    def run_due(self, now_us: int) -> None:
        """Run every duty whose deadline has passed."""
        for due, run in self._deadlines:
            if (due_us := due()) is not None and now_us >= due_us:
                run(now_us)

    def next_us(self, step_due_us: int | None = None) -> int:
        """Return the earliest deadline, or the time of the next step if that is earlier."""
        dues = [step_due_us, *(due() for due, _ in self._deadlines)]
        return min(due_us for due_us in dues if due_us is not None)
