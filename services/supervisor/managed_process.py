"""Managed child process of the supervisor: session, log file, heartbeat pipe, exit code.

A dead process is noticed within milliseconds: the kernel closes its end of the heartbeat pipe, and ``select`` in
``child_processes.py`` returns. A process that hangs keeps the pipe open and is found by its silence
(``hang_detector.py``).
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple, Protocol

from services.runtime.supervisor_link import HEARTBEAT_FORMAT, LAST_HEARTBEAT, STATE_LENGTH
from services.supervisor import entry_point
from services.supervisor.forkserver import ForkServer
from services.supervisor.hang_detector import HANG_TIMEOUT_S, HangDetector, ProcessorLack
from services.supervisor.parent_death import OrphanCleanup

LAST_LINES = 12
LOG_TAIL_BYTES = 16_384
PIPE_BYTES = 1 << 20  # a state fits into the pipe, so that a stopped child does not block the supervisor
HEARTBEAT_BYTES = 4096  # read at once
EXIT_TIMEOUT_S = 0.2  # from the end of the heartbeat pipe to the exit of the process


class ProcessHandle(Protocol):
    """Handle of a forked or spawned process, as ``subprocess.Popen``."""

    pid: int

    def poll(self) -> int | None: ...
    def wait(self, timeout: float | None = None) -> int: ...
    def send_signal(self, sig: int, /) -> None: ...
    def kill(self) -> None: ...


class Program(NamedTuple):
    """Program of a child process: its name, module, config file and log file."""

    name: str
    module: str
    config: Path
    log: Path


class ManagedProcess:
    """Child process, started on construction.

    It must be constructed by the main thread: the kernel kills a child when the thread that spawned or adopted it ends.
    The child is forked if ``forks`` can fork it, and spawned otherwise, which takes longer (see ``forkserver.py``).
    ``state`` is the encoded state that it continues from; empty if it begins without one.
    """

    def __init__(
        self,
        program: Program,
        *,
        cleanup: OrphanCleanup,
        forks: ForkServer | None = None,
        state: bytes = b"",
        hang_timeout_s: float = HANG_TIMEOUT_S,
    ) -> None:
        self.name = program.name
        self.pipe_closed = False
        """True once the child has closed its heartbeat pipe: it has ended, or is about to."""
        self.heartbeat_fd = -1
        """Reading end of the heartbeat pipe: readable when a heartbeat arrives and when the child ends."""
        self._log = program.log
        self._cleanup = cleanup
        self._removed = False  # from the list of the orphan cleanup
        self._stdin = -1
        process: ProcessHandle | None = None
        if forks is not None:
            process = self._start(lambda stdin, heartbeat: forks.fork(*program[1:], stdin, heartbeat))
        if process is None:
            process = self._start(lambda stdin, heartbeat: _spawn(program, stdin, heartbeat))
        assert process is not None
        self._process = process
        self.hang_detector = HangDetector(ProcessorLack(self.pid), hang_timeout_s)
        cleanup.add(self.pid)
        with contextlib.suppress(BrokenPipeError):  # the child is already dead, which is noticed elsewhere
            os.write(self._stdin, STATE_LENGTH.pack(len(state)) + state)

    def _start(self, start: Callable[[int, int], ProcessHandle | None]) -> ProcessHandle | None:
        """Start the child by ``start``, which receives the child's ends of two new pipes.

        If ``start`` returns None, both pipes are closed. A child that was forked too late ends at the end of its input.
        """
        stdin, self._stdin = os.pipe()
        _widen(self._stdin)
        self.heartbeat_fd, heartbeat = os.pipe()
        os.set_blocking(self.heartbeat_fd, False)
        try:
            process = start(stdin, heartbeat)
        finally:
            os.close(heartbeat)
            os.close(stdin)
        if process is None:
            self.close()
        return process

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    def read_heartbeats(self) -> None:
        """Read the heartbeats that have arrived. At the end of the pipe, wait for the exit, which follows at once."""
        with contextlib.suppress(BlockingIOError):
            while data := os.read(self.heartbeat_fd, HEARTBEAT_BYTES):
                for (at_us,) in HEARTBEAT_FORMAT.iter_unpack(data):
                    if at_us == LAST_HEARTBEAT:
                        self.hang_detector.end()
                    else:
                        self.hang_detector.beat(at_us / 1e6)
            self.pipe_closed = True
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(EXIT_TIMEOUT_S)

    def exit_code(self) -> int | None:
        """Return the exit code, or minus the number of the signal that ended the child; None while it runs."""
        code = self._process.poll()
        if code is not None and not self._removed:
            self._removed = True
            self._cleanup.remove(self.pid)
        return code

    def terminate(self) -> None:
        """Send SIGTERM: the child finishes its step, publishes its last status and exits."""
        if self.exit_code() is None:
            self._process.send_signal(signal.SIGTERM)

    def wait_or_kill(self, timeout_s: float) -> bool:
        """Wait for the exit, then kill the child. Return False if it had to be killed."""
        try:
            self._process.wait(max(0.0, timeout_s))
        except subprocess.TimeoutExpired:
            self._process.kill()  # SIGKILL also ends a stopped process
            self._process.wait()
            self.exit_code()
            return False
        self.exit_code()
        return True

    def kill(self) -> None:
        """Send SIGKILL, which also ends a process that is stopped or hangs, and wait for the exit."""
        self.wait_or_kill(0.0)

    def close(self) -> None:
        """Close both pipes."""
        if self.heartbeat_fd >= 0:
            os.close(self.heartbeat_fd)
            self.heartbeat_fd = -1
        if self._stdin >= 0:
            os.close(self._stdin)
            self._stdin = -1

    def last_lines(self) -> tuple[str, ...]:
        """Return the last lines of the child's log."""
        return last_lines(self._log)


def _spawn(program: Program, stdin: int, heartbeat: int) -> ProcessHandle:
    arguments = (str(os.getpid()), program.module, str(program.config), str(heartbeat))
    with program.log.open("wb") as output:
        return subprocess.Popen(
            [sys.executable, "-P", "-m", entry_point.__name__, *arguments],
            stdin=stdin,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            pass_fds=(heartbeat,),
        )


def _widen(pipe: int) -> None:
    """Set the capacity of a pipe to ``PIPE_BYTES``."""
    import fcntl

    if hasattr(fcntl, "F_SETPIPE_SZ"):  # Linux
        with contextlib.suppress(OSError):  # more than this user is allowed
            fcntl.fcntl(pipe, fcntl.F_SETPIPE_SZ, PIPE_BYTES)


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
