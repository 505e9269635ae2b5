"""One child process of the supervisor: in a session of its own, its words in a log, its end never missed."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from services.runtime.supervisor_link import HEARTBEAT_FORMAT, LAST_HEARTBEAT, STATE_LENGTH
from services.supervisor import entry_point
from services.supervisor.forkserver import ForkServer
from services.supervisor.hang_detector import HANG_TIMEOUT_S, HangDetector
from services.supervisor.parent_death import OrphanCleanup

LAST_LINES = 12
LOG_TAIL_BYTES = 16_384
PIPE_BYTES = 1 << 20  # what is said to a child fits into its pipe, so that a stopped one holds nobody up
BEATS = 4096  # bytes taken at once
EXIT_S = 0.2  # from the end of its pipes to that of the process


class Process(Protocol):
    """What was forked or spawned."""

    pid: int

    def poll(self) -> int | None: ...
    def wait(self, timeout: float | None = None) -> int: ...
    def send_signal(self, sig: int, /) -> None: ...
    def kill(self) -> None: ...


class ManagedProcess:
    """Start it from the main thread only: a child dies with the thread that spawned it, or has adopted it.

    ``config`` is the file of its config, ``state`` the state to go on from, as it travels, or nothing. It is forked
    where ``forks`` can, and else spawned, which takes longer (``forkserver.py`` has the figures).
    """

    def __init__(
        self,
        name: str,
        module: str,
        config: Path,
        *,
        log: Path,
        guard: OrphanCleanup,
        forks: ForkServer | None = None,
        state: bytes = b"",
        patience_s: float = HANG_TIMEOUT_S,
    ) -> None:
        self.name = name
        self.gone = False  # it has closed its pulse: nothing more comes from it
        self.heartbeat = HangDetector(patience_s)
        self._log = log
        self._guard = guard
        self._released = False
        self._stdin = -1
        self.pulse = -1
        """To be watched: it can be read when the child beats, and when it is no more."""
        process: Process | None = None
        if forks is not None:
            process = self._start(lambda stdin, beats: forks.fork(module, config, log, stdin, beats))
        if process is None:
            process = self._start(lambda stdin, beats: _spawn(module, config, log, stdin, beats))
        assert process is not None
        self._process = process
        guard.watch(self.pid)
        with contextlib.suppress(BrokenPipeError):  # it is dead itself, which shows elsewhere
            os.write(self._stdin, STATE_LENGTH.pack(len(state)) + state)

    def _start(self, start: Callable[[int, int], Process | None]) -> Process | None:
        """By ``start``, which is given the child's ends of two new pipes. Where it gives nothing, both are closed: one
        that was forked nonetheless, too late, ends at the end of its input.
        """
        stdin, self._stdin = os.pipe()
        _widen(self._stdin)
        self.pulse, beats = os.pipe()
        os.set_blocking(self.pulse, False)
        try:
            process = start(stdin, beats)
        finally:
            os.close(beats)
            os.close(stdin)
        if process is None:
            self.close()
        return process

    @property
    def pid(self) -> int:
        """Of the process."""
        return self._process.pid

    def listen(self) -> None:
        """Take the pulses that have come; after the last one of all, wait for the exit, which is not far."""
        with contextlib.suppress(BlockingIOError):
            while beats := os.read(self.pulse, BEATS):
                for (at_us,) in HEARTBEAT_FORMAT.iter_unpack(beats):
                    if at_us == LAST_HEARTBEAT:
                        self.heartbeat.end()
                    else:
                        self.heartbeat.beat(at_us / 1e6)
            self.gone = True
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(EXIT_S)

    def starved_s(self) -> float:
        """How long its loop has waited for a processor so far."""
        return starved_s(self.pid)

    def waits_for_the_disk(self) -> bool:
        """Whether it is in a wait that not even SIGKILL ends, as of a write to a slow disk."""
        try:
            stat = Path(f"/proc/{self.pid}/stat").read_text(encoding="utf-8", errors="replace")
        except OSError:
            return False
        return stat.rpartition(")")[2].split()[0] == "D"

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

    def kill(self) -> None:
        """SIGKILL, which a process that is stopped or hangs obeys too."""
        self.end(0.0)

    def close(self) -> None:
        """Nothing is left to say to it, or to hear."""
        if self.pulse >= 0:
            os.close(self.pulse)
            self.pulse = -1
        if self._stdin >= 0:
            os.close(self._stdin)
            self._stdin = -1

    def last_lines(self) -> tuple[str, ...]:
        """The end of what it said."""
        return last_lines(self._log)


def _spawn(module: str, config: Path, log: Path, stdin: int, beats: int) -> Process:
    with log.open("wb") as output:
        return subprocess.Popen(
            [sys.executable, "-P", "-m", entry_point.__name__, str(os.getpid()), module, str(config), str(beats)],
            stdin=stdin,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            pass_fds=(beats,),
        )


def _widen(pipe: int) -> None:
    import fcntl

    if hasattr(fcntl, "F_SETPIPE_SZ"):  # Linux
        with contextlib.suppress(OSError):  # beyond what this user may have
            fcntl.fcntl(pipe, fcntl.F_SETPIPE_SZ, PIPE_BYTES)


def starved_s(pid: int) -> float:
    """How long a process's main thread has waited for a processor so far (s); 0 where nobody says."""
    try:
        _, waited_ns, _ = Path(f"/proc/{pid}/task/{pid}/schedstat").read_text(encoding="utf-8").split()
    except (OSError, ValueError):
        return 0.0
    return int(waited_ns) / 1e9


def last_lines(log: Path) -> tuple[str, ...]:
    """The end of a log; nothing where there is none."""
    try:
        text = log.read_bytes()[-LOG_TAIL_BYTES:].decode(errors="replace")
    except OSError:
        return ()
    return tuple(line for line in text.splitlines() if line.strip())[-LAST_LINES:]


def describe_exit(code: int) -> str:
    """An exit code in words."""
    if code >= 0:
        return f"ended with exit code {code}"
    try:
        return f"was ended by {signal.Signals(-code).name}"
    except ValueError:
        return f"was ended by signal {-code}"
