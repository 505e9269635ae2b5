"""Fork server: a process that has loaded what the others of a run need, and forks them. Both its ends are here.

Its reason, measured on two cores (docs/notes/process-start.md): a run is ready after 3.0 s with it and 4.7 s without,
for 1.7 and 6.1 s of processor time; a dead estimator or controller is back after at most 0.94 s with it and 2.7 s
without, where 2 s are promised (docs/faults.md). A fork uses nothing up: the second fault is mended as quickly as the
first.

    request   module, config and log (JSON), with the child's standard input and its pulse (descriptors)
    answer    the child's pid; the first one, ``LOADED``, says that it is ready

The server has one thread and opens no session, so a fork finds every lock free. A child is forked twice, and who stands
between ends at once: so the supervisor, as the nearest subreaper, becomes its parent, waits for it, and is outlived by
it no more than by a child that it has spawned itself. The server may die without anyone else.
"""

from __future__ import annotations

import ctypes
import gc
import os
import select
import signal
import socket
import struct
import subprocess
import sys
import time
import traceback
from pathlib import Path
from typing import NoReturn

import msgspec

from services.supervisor import entry_point
from services.supervisor.parent_death import OrphanCleanup, die_with_parent

PR_SET_CHILD_SUBREAPER = 36
PID = struct.Struct("<q")
LOADED = 0
"""In place of a pid."""

PROGRAM = ("-m", "services.supervisor.forkserver")
NAME = "ltv-forkserver"
MOST_BYTES = 65_536  # of a request
DESCRIPTORS = 2
ANSWER_S = 2.0
"""A fork takes some ten milliseconds, on a machine that is full some hundred; who does not answer is done for."""

ADOPTION_S = 2.0  # at most so long a child waits for its new parent, who may be no more


class Request(msgspec.Struct, frozen=True):
    """Who is to be forked."""

    module: str
    config: str
    log: str


# --- the supervisor's end --------------------------------------------------------------------------------------------


def possible() -> bool:
    """Return True if the system has what it takes: Linux, and not one of its imitations."""
    if sys.platform != "linux" or not hasattr(ctypes.CDLL(None), "prctl"):
        return False
    try:
        os.close(os.pidfd_open(os.getpid()))
    except OSError:
        return False
    return True


class ForkServer:
    """Starts to load at once; to be made by the main thread, which the children live with."""

    def __init__(self, scenario: Path, log: Path, guard: OrphanCleanup) -> None:
        self.log = log
        self.loaded = False
        self._guard = guard
        _adopt(True)
        self._requests, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs, log.open("wb") as output:
            self._process = subprocess.Popen(
                [sys.executable, "-P", *PROGRAM, str(os.getpid()), str(theirs.fileno()), str(scenario)],
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
            self.loaded = self._answer() == LOADED
        return self.loaded

    def fork(self, module: str, config: Path, log: Path, stdin: int, pulse: int) -> Forked | None:
        """Fork a child; None where it cannot be had, for now or for good."""
        if not self.is_loaded():
            return None
        request = msgspec.json.encode(Request(module, str(config), str(log)))
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
    """A child that the fork server has forked, as ``subprocess.Popen`` has one that it has spawned."""

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


# --- the server ------------------------------------------------------------------------------------------------------


def main() -> None:
    """``sys.argv``: the parent's pid, the descriptor of the socket to it, the scenario."""
    parent, channel, scenario = sys.argv[1:]
    die_with_parent(int(parent))
    entry_point.name_process(NAME)
    load(scenario)
    gc.collect()
    gc.freeze()  # no collection of a child writes to what all share
    with socket.socket(fileno=int(channel)) as requests:
        requests.send(PID.pack(LOADED))
        while True:
            data, descriptors, _, _ = socket.recv_fds(requests, MOST_BYTES, DESCRIPTORS)
            if not data:
                return
            pid = _fork(int(parent), msgspec.json.decode(data, type=Request), descriptors, requests)
            requests.send(PID.pack(pid))


def load(scenario: str) -> None:
    """Import what the processes of this scenario use, and warm up its nodes."""
    import services.processes.recorder
    import services.processes.router  # noqa: F401
    from services.supervisor import jit_cache

    jit_cache.warm_up(scenario)


def _fork(parent: int, request: Request, descriptors: list[int], requests: socket.socket) -> int:
    """The pid of a child of ``parent``."""
    said, say = os.pipe()
    between = os.fork()
    if between == 0:
        try:
            pid = os.fork()
            if pid == 0:
                for end in (said, say):
                    os.close(end)
                requests.close()
                _become(parent, request, descriptors)
            os.write(say, PID.pack(pid))
        finally:
            os._exit(0)
    for end in (say, *descriptors):
        os.close(end)
    with os.fdopen(said, "rb") as answer:
        (pid,) = PID.unpack(answer.read(PID.size))
    os.waitpid(between, 0)
    return int(pid)


def _become(parent: int, request: Request, descriptors: list[int]) -> NoReturn:
    """Be the child that is asked for, to the end."""
    code = 1
    try:
        os.setsid()
        stdin, pulse = descriptors
        log = os.open(request.log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o666)
        for number, place in ((stdin, 0), (log, 1), (log, 2)):
            os.dup2(number, place)
        os.close(stdin)
        os.close(log)
        until = time.monotonic() + ADOPTION_S
        while os.getppid() != parent and time.monotonic() < until:
            time.sleep(0.001)
        code = entry_point.run(str(parent), request.module, request.config, str(pulse))
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


if __name__ == "__main__":
    main()
