"""Managed child process of the supervisor: log file, lifeline, exit code.

A dead process is noticed within milliseconds: its pidfd becomes readable, and ``select`` in ``child_processes.py``
returns. A process that hangs is found by its silence:
it hangs if the loop that does its work sends no heartbeats, as with a systemd watchdog.

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
import select
import signal
import time
from collections.abc import Callable
from pathlib import Path

from services.runtime.lifeline import STOPPING, WATCHDOG
from services.supervisor.forkserver import ForkServer
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


LAST_LINES = 12
LOG_TAIL_BYTES = 16_384
NOTIFICATION_BYTES = 4096
SIMULATION_HANG_TIMEOUT_S = 10.0  # plant and sensors are not restarted: a busy machine must not end the run too early
KILL_TIMEOUT_S = 5.0  # longest wait for the exit after SIGKILL, which a process that waits for a dead disk survives


class ManagedProcess:
    """Child process of one row of the process table, named after its config file, and the next ones in its place.

    ``start`` must be called by the main thread: the kernel kills a child when the thread that adopted it ends.
    """

    def __init__(self, forks: ForkServer, row: ProcessRow, config: Path) -> None:
        self.row = row
        self.hang_detector: HangDetector
        self.pid = 0
        self.descriptors: tuple[int, ...] = ()
        """Lifeline and pidfd of the child: one of them is readable when it has sent something or has ended."""
        self._forks = forks
        self._config = config
        self._log: Path
        self._starts = 0
        self._code: int | None = None

    def start(self, state: bytes = b"") -> None:
        """Start a child, in place of a dead one. ``state`` is the encoded state that it continues from, or empty."""
        self.close()
        self._starts += 1
        self._log = self._config.with_suffix(".log" if self._starts == 1 else f".{self._starts}.log")
        self.pid, lifeline = self._forks.start(self.row.module, self._config, self._log, state)
        self._code = None
        self.descriptors = lifeline, os.pidfd_open(self.pid)
        timeout_s = HANG_TIMEOUT_S if self.row.restartable else SIMULATION_HANG_TIMEOUT_S
        self.hang_detector = HangDetector(ProcessorLack(self.pid), timeout_s)

    def read_heartbeats(self) -> None:
        """Read the heartbeats that have arrived."""
        with contextlib.suppress(BlockingIOError, ConnectionResetError):  # reset: it died while it still waited
            while notification := os.read(self.descriptors[0], NOTIFICATION_BYTES):
                if notification == WATCHDOG:
                    self.hang_detector.beat(time.monotonic())
                elif notification == STOPPING:
                    self.hang_detector.end()

    def exit_code(self) -> int | None:
        """Return the exit code, or minus the number of the signal that ended the child; None while it runs."""
        if self._code is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                self._code = os.waitstatus_to_exitcode(status)
        return self._code

    def terminate(self) -> None:
        """Send SIGTERM: the child finishes its step, publishes its last status and exits."""
        self._send(signal.SIGTERM)

    def wait_or_kill(self, timeout_s: float) -> bool:
        """Wait for the exit, then kill the child. Return False if it had to be killed."""
        if self._wait(max(0.0, timeout_s)):
            return True
        self.kill()
        return False

    def kill(self) -> None:
        """Send SIGKILL, which also ends a process that is stopped or hangs, and wait for the exit."""
        self._send(signal.SIGKILL)
        self._wait(KILL_TIMEOUT_S)

    def close(self) -> None:
        """Close all descriptors; the exit code stays."""
        for fd in self.descriptors:
            os.close(fd)
        self.descriptors = ()

    def last_lines(self) -> tuple[str, ...]:
        """Return the last lines of the child's log."""
        return last_lines(self._log)

    def _send(self, number: int) -> None:
        """Send a signal if the child runs; its pid is not reused before it was waited for."""
        if self.exit_code() is None:
            os.kill(self.pid, number)

    def _wait(self, timeout_s: float) -> bool:
        """Wait for the exit. Return False if the child still runs."""
        if self.exit_code() is None:
            select.select(self.descriptors[1:], [], [], timeout_s)
        return self.exit_code() is not None


def last_lines(log: Path) -> tuple[str, ...]:
    """Return the last lines of a log file; none if there is no such file."""
    try:
        text = log.read_bytes()[-LOG_TAIL_BYTES:].decode(errors="replace")
    except OSError:
        return ()
    return tuple(line for line in text.splitlines() if line.strip())[-LAST_LINES:]


def describe_exit(code: int) -> str:
    """Describe an exit code, or minus a signal number, as in "was ended by SIGKILL"."""
    if code >= 0:
        return f"ended with exit code {code}"
    try:
        return f"was ended by {signal.Signals(-code).name}"
    except ValueError:
        return f"was ended by signal {-code}"
