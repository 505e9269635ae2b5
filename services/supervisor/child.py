"""Child process of the supervisor, by its pid and its pidfd, and what its exit code and its log say."""

from __future__ import annotations

import os
import select
import signal
from pathlib import Path

LAST_LINES = 12
LOG_TAIL_BYTES = 16_384
KILL_TIMEOUT_S = 5.0  # longest wait for the exit after SIGKILL, which a process that waits for a dead disk survives


class Child:
    """Child process of this one."""

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self.pidfd = os.pidfd_open(pid)
        """Descriptor that is readable once the child has ended."""
        self._code: int | None = None

    def exit_code(self) -> int | None:
        """Return the exit code, or minus the number of the signal that ended the child; None while it runs."""
        if self._code is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            self._code = os.waitstatus_to_exitcode(status) if pid else None
        return self._code

    def terminate(self) -> None:
        """Send SIGTERM: a process of a run finishes its step, publishes its last status and exits."""
        self._send(signal.SIGTERM)

    def wait(self, timeout_s: float) -> bool:
        """Wait for the exit. Return False if the child still runs."""
        if self.exit_code() is None:
            select.select([self.pidfd], [], [], max(0.0, timeout_s))
        return self.exit_code() is not None

    def kill(self) -> None:
        """Send SIGKILL, which also ends a process that is stopped or hangs, and wait for the exit."""
        self._send(signal.SIGKILL)
        self.wait(KILL_TIMEOUT_S)

    def close(self) -> None:
        """Close the descriptor; the exit code stays."""
        os.close(self.pidfd)

    def _send(self, number: signal.Signals) -> None:
        """Send a signal if the child runs; its pid is not reused before it was waited for."""
        if self.exit_code() is None:
            os.kill(self.pid, number)


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
