"""Hang detection: a process hangs if the loop that does its work sends no heartbeats, as with a systemd watchdog.

    silent = now - max(last heartbeat, excused)
    hung  <=>  silent - starved > timeout      from the first heartbeat until the process reports the end of its loop

``excused`` is the last time at which the supervisor itself was late: if the whole machine was suspended, no process
could send heartbeats either. ``starved`` is the part of the silence in which the loop was ready to run but waited for a
processor that other processes had; a restart would not help it. A stopped or blocked loop does not wait for a
processor, and a loop that spins has one: both are detected. Times are seconds of one monotonic clock.
"""

from __future__ import annotations

from collections.abc import Callable

HANG_TIMEOUT_S = 0.5
"""Five heartbeats. A step of a node takes milliseconds."""

QUIET_S = 0.2
"""Two heartbeats: silence after which the time without a processor is measured."""

LATE_S = 0.25
"""Interval between two checks of the supervisor that counts as late; it checks twenty times a second."""


class HangDetector:
    """Heartbeats of one process."""

    def __init__(self, timeout_s: float = HANG_TIMEOUT_S) -> None:
        self._timeout_s = timeout_s
        self._last_s: float | None = None
        self._excused_s = float("-inf")
        self._starved_before_s: float | None = None  # cpu_wait_s when the silence was first noticed
        self._ended = False

    def beat(self, at_s: float) -> None:
        """Note a heartbeat that was sent at ``at_s``."""
        self._last_s = at_s if self._last_s is None else max(self._last_s, at_s)

    def end(self) -> None:
        """Note that the loop has ended in order: no more heartbeats are expected."""
        self._ended = True

    def excuse(self, now_s: float) -> None:
        """Restart the timeout, because the supervisor itself was late."""
        self._excused_s = now_s

    @property
    def last_s(self) -> float | None:
        """Time of the newest heartbeat; None before the first."""
        return self._last_s

    def hung(self, now_s: float, cpu_wait_s: Callable[[], float]) -> bool:
        """Return True if the process hangs. Must be called often.

        ``cpu_wait_s`` returns how long the loop has waited for a processor since it started.
        """
        if self._last_s is None or self._ended:
            return False
        silent_s = now_s - max(self._last_s, self._excused_s)
        if silent_s < QUIET_S:
            self._starved_before_s = None
            return False
        waited_s = cpu_wait_s()
        if self._starved_before_s is None:
            self._starved_before_s = waited_s
        return silent_s - (waited_s - self._starved_before_s) > self._timeout_s
