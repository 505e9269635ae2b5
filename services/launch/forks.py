"""The supervisor's end of the fork server, and a process that was forked for it."""

from __future__ import annotations

import ctypes
import os
import select
import signal
import socket
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import msgspec

from services.launch import forkserver
from services.launch.forkserver import PID, Request
from services.launch.orphans import Guard

PR_SET_CHILD_SUBREAPER = 36
ROOM = "-" * 4096
"""An argument that is overwritten: the children's command lines are longer than the fork server's own."""

PROGRAM = ("-m", forkserver.__name__)

ANSWER_S = 2.0
"""A fork takes some ten milliseconds, on a machine that is full some hundred; who does not answer is done for."""


def possible() -> bool:
    """Whether the system has what it takes: Linux, and not one of its imitations."""
    if sys.platform != "linux" or not hasattr(ctypes.CDLL(None), "prctl"):
        return False
    try:
        os.close(os.pidfd_open(os.getpid()))
    except OSError:
        return False
    return True


class ForkServer:
    """Starts to load at once; to be made by the main thread, which the children live with."""

    def __init__(self, scenario: Path, log: Path, guard: Guard) -> None:
        self.log = log
        self.loaded = False
        self._guard = guard
        _adopt(True)
        self._requests, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        words = (str(os.getpid()), str(theirs.fileno()), str(scenario), ROOM)
        with theirs, log.open("wb") as output:
            self._process = subprocess.Popen(
                [sys.executable, "-P", *PROGRAM, *words],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                pass_fds=(theirs.fileno(),),
            )
        guard.watch(self._process.pid)

    @property
    def pid(self) -> int:
        """Of the fork server itself."""
        return self._process.pid

    def exit_code(self) -> int | None:
        """None while it runs."""
        return self._process.poll()

    def is_loaded(self) -> bool:
        """Whether it can fork."""
        if not self.loaded and self._answers(0.0):
            self.loaded = self._answer() == forkserver.LOADED
        return self.loaded

    def fork(self, command: Sequence[str], log: Path, stdin: int, pulse: int) -> Forked | None:
        """The child with this command line; None where it cannot be had, for now or for good."""
        if not self.is_loaded():
            return None
        request = msgspec.json.encode(Request(tuple(command), str(log)))
        try:
            socket.send_fds(self._requests, [request], [stdin, pulse])
            pid = self._answer() if self._answers(ANSWER_S) else None
        except OSError:
            pid = None
        if pid is None:
            self.loaded = False
            self._process.kill()
            return None
        return Forked(pid)

    def close(self) -> None:
        """Nobody is forked any more; who was lives on."""
        self._requests.close()
        self._process.kill()
        self._process.wait()
        self._guard.release(self._process.pid)
        _adopt(False)

    def _answers(self, within_s: float) -> bool:
        return bool(select.select([self._requests], [], [], within_s)[0])

    def _answer(self) -> int | None:
        data = self._requests.recv(PID.size)
        return int(PID.unpack(data)[0]) if data else None


class Forked:
    """A child that somebody else has forked, as ``subprocess.Popen`` has one that it has spawned."""

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self._code: int | None = None
        self._ended = os.pidfd_open(pid)

    def poll(self) -> int | None:
        """Its exit code, minus the signal's number where one ended it; None while it runs."""
        if self._code is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                self._code = os.waitstatus_to_exitcode(status)
                os.close(self._ended)
        return self._code

    def wait(self, timeout: float | None = None) -> int:
        """The exit code. Raises ``subprocess.TimeoutExpired``."""
        if self._code is None:
            ended = select.poll()
            ended.register(self._ended, select.POLLIN)
            ended.poll(None if timeout is None else 1000.0 * timeout)
        code = self.poll()
        if code is None:
            raise subprocess.TimeoutExpired("a forked process", timeout or 0.0)
        return code

    def send_signal(self, number: int) -> None:
        """To it, if it runs: nobody else can have its pid before it was waited for."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        """SIGKILL."""
        self.send_signal(signal.SIGKILL)


def _adopt(whether: bool) -> None:
    """Whose parent ends becomes a child of this process."""
    ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, int(whether), 0, 0, 0)
