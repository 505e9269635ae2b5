"""One child process of the supervisor: spawned in a session of its own, its words in a log, its end never missed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

from services.launch.orphans import Guard

LAST_LINES = 12
LOG_TAIL_BYTES = 16_384


class Child:
    """Spawn from the main thread only: a child dies with the thread that spawned it."""

    def __init__(self, name: str, command: list[str], *, log: Path, guard: Guard) -> None:
        self.name = name
        self._log = log
        self._guard = guard
        self._released = False
        with log.open("wb") as output:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "services.launch.child", str(os.getpid()), *command],
                stdin=subprocess.PIPE,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        guard.watch(self.pid)

    @property
    def pid(self) -> int:
        """Of the process."""
        return self._process.pid

    def exit_code(self) -> int | None:
        """None while it runs; minus the signal's number where one ended it."""
        code = self._process.poll()
        if code is not None and not self._released:
            self._released = True
            self._guard.release(self.pid)
        return code

    def ask_to_stop(self) -> None:
        """SIGTERM: finish the step, say the last word, exit. The recorder finishes its file."""
        if self.exit_code() is None:
            self._process.send_signal(signal.SIGTERM)

    def end(self, within_s: float) -> bool:
        """Wait for its exit, then kill it; whether it went by itself."""
        try:
            self._process.wait(max(0.0, within_s))
        except subprocess.TimeoutExpired:
            self._process.kill()  # also what is stopped: SIGKILL needs nobody's cooperation
            self._process.wait()
            self.exit_code()
            return False
        self.exit_code()
        return True

    def close(self) -> None:
        """Nothing is left to say to it."""
        if self._process.stdin is not None:
            self._process.stdin.close()

    def last_lines(self) -> tuple[str, ...]:
        """The end of what it said."""
        return last_lines(self._log)


def last_lines(log: Path) -> tuple[str, ...]:
    """The end of a log; nothing where there is none."""
    try:
        text = log.read_bytes()[-LOG_TAIL_BYTES:].decode(errors="replace")
    except OSError:
        return ()
    return tuple(line for line in text.splitlines() if line.strip())[-LAST_LINES:]


def how_it_ended(code: int) -> str:
    """An exit code in words."""
    if code >= 0:
        return f"ended with exit code {code}"
    try:
        return f"was ended by {signal.Signals(-code).name}"
    except ValueError:
        return f"was ended by signal {-code}"
