"""Managed child process of the supervisor: log file, lifeline, exit code.

A dead process is noticed within milliseconds: its pidfd becomes readable, and ``select`` in ``child_processes.py``
returns. A process that hangs is found by its silence
(``hang_detector.py``).
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import time
from pathlib import Path

from services.runtime.lifeline import STOPPING, WATCHDOG
from services.supervisor.forkserver import ForkServer
from services.supervisor.hang_detector import HANG_TIMEOUT_S, HangDetector, ProcessorLack
from services.supervisor.process_table import ProcessRow

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
