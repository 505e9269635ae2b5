"""Process of a run: its log, its lifeline, and its heartbeats, by which a hang is found.

A process hangs if the loop that does its work sends no heartbeats, as with a systemd watchdog.

    served  <-  served + (tick - lacked)    at each check, from the newest heartbeat on
    hung   <=>  served > timeout            from the first heartbeat until the process reports the end of its loop

``tick`` is the time since the check before. ``lacked`` is the part of it in which a thread of the process was ready to
run but waited for a processor that other processes had, or waited for a disk; a restart would not help it. All threads
count, because the loop may wait for one of them. A stopped or blocked process does not wait for a processor, and a loop
that spins has one: both are detected. If the supervisor itself was late, the time begins again: the whole machine may
have been suspended. Times are seconds of one monotonic clock.
"""

from __future__ import annotations

import contextlib
import math
import os
import time
from collections.abc import Callable
from pathlib import Path

from services.runtime.lifeline import STOPPING, WATCHDOG
from services.supervisor.child import Child
from services.supervisor.process_table import ProcessRow

HANG_TIMEOUT_S = 0.5
"""Five heartbeats. A step of a node takes milliseconds."""

QUIET_S = 0.2
"""Two heartbeats: silence after which the time without a processor is measured."""

LATE_S = 0.25
"""Interval between two checks of the supervisor that counts as late; it checks twenty times a second."""


class HangDetector:
    """Heartbeats of one process. ``lacked_s`` returns the time without a processor since its last call."""

    def __init__(self, lacked_s: Callable[[], float], timeout_s: float = HANG_TIMEOUT_S) -> None:
        self.last_s: float | None = None
        """Time of the newest heartbeat; None before the first."""
        self._lacked_s = lacked_s
        self._timeout_s = timeout_s
        self._checked_s = math.inf
        self._served_s: float | None = None  # None: the process is not silent

    def beat(self, at_s: float) -> None:
        """Note a heartbeat that has arrived at ``at_s``."""
        self.last_s = at_s

    def end(self) -> None:
        """Note that the loop has ended in order: no more heartbeats are expected."""
        self._timeout_s = math.inf

    def hung(self, now_s: float) -> bool:
        """Return True if the process hangs. Must be called often."""
        tick_s, self._checked_s = now_s - self._checked_s, now_s
        if self.last_s is None:
            return False
        silent_s = now_s - self.last_s
        if silent_s < QUIET_S:
            self._served_s = None
            return False
        lacked_s = self._lacked_s()
        if tick_s > LATE_S:
            self._served_s = 0.0
        elif self._served_s is None:
            self._served_s = silent_s
        else:
            self._served_s += max(0.0, tick_s - lacked_s)
        return self._served_s > self._timeout_s


class ProcessorLack:
    """Time that the threads of a process have waited for a processor, or for a disk; 0 if the system does not tell."""

    def __init__(self, pid: int) -> None:
        self._tasks = Path(f"/proc/{pid}/task")
        self._before: dict[str, tuple[int, int]] = {}  # by thread: time on a processor and time waited for one (ns)

    def __call__(self) -> float:
        """Return the time since the last call (s); infinite if a thread has waited all the time and still does.

        The kernel counts the wait of a thread when it is over.
        """
        before, self._before = self._before, {}
        lacked_ns = 0.0
        with contextlib.suppress(OSError, ValueError):
            for task in self._tasks.iterdir():
                ran_ns, waited_ns, _ = map(int, (task / "schedstat").read_text().split())
                state = (task / "stat").read_text(errors="replace").rpartition(")")[2].split()[0]
                self._before[task.name] = ran_ns, waited_ns
                if task.name in before:
                    ran_before_ns, waited_before_ns = before[task.name]
                    lacked_ns += waited_ns - waited_before_ns
                    if state == "D" or (state == "R" and ran_ns == ran_before_ns):
                        lacked_ns = math.inf
        return lacked_ns / 1e9


NOTIFICATION_BYTES = 4096
SIMULATION_HANG_TIMEOUT_S = 10.0  # plant and sensors are not restarted: a busy machine must not end the run too early


class ManagedProcess(Child):
    """Child process of one row of the process table, with its log, its lifeline and its heartbeats."""

    def __init__(self, pid: int, lifeline: int, row: ProcessRow, log: Path, number: int) -> None:
        """Watch the process of a pid, the ``number``-th start of its row."""
        super().__init__(pid)
        self.row, self.log, self.number, self.lifeline = row, log, number, lifeline
        timeout_s = HANG_TIMEOUT_S if row.restartable else SIMULATION_HANG_TIMEOUT_S
        self.hang_detector = HangDetector(ProcessorLack(pid), timeout_s)

    def read_heartbeats(self) -> None:
        """Read the heartbeats that have arrived."""
        with contextlib.suppress(BlockingIOError, ConnectionResetError):  # reset: it died while it still waited
            while notification := os.read(self.lifeline, NOTIFICATION_BYTES):
                if notification == WATCHDOG:
                    self.hang_detector.beat(time.monotonic())
                elif notification == STOPPING:
                    self.hang_detector.end()

    def close(self) -> None:
        """Close all descriptors; the exit code stays."""
        os.close(self.lifeline)
        super().close()
