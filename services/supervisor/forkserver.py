"""Fork server: a process that starts the processes of a run as forks of itself, once it has loaded what they need.

This file holds the supervisor's handle and the server's program.

It makes starts and restarts quicker, because a forked process need not import and load compiled code: a failed
estimator or controller must be back within 2 s (docs/restarts.md). Measured times are in docs/notes/process-start.md.
The server is the same after a fork, so the second restart is as quick as the first.

    request   module, config and log (JSON), with the child's standard input and heartbeat pipe (descriptors)
    reply     the child's pid
    request   nothing: load; the reply, ``LOADED``, comes when that is done

While it loads it also forks: such a child imports what is missing itself, as the router, which is the first of all.
The server has one thread and opens no Zenoh session, so no lock is held during a fork. It forks twice, and the process
in between ends at once. The supervisor, as the nearest subreaper, then adopts the child: it can wait for it, and the
child dies with it. If the server dies, its children live on, and another one takes its place. The standard library's
fork server stays the parent of its children: they would die with it, or outlive the supervisor.
"""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import gc
import os
import select
import socket
import struct
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple, NoReturn

import msgspec

from services.supervisor import entry_point
from services.supervisor.parent_death import die_with_parent

PR_SET_CHILD_SUBREAPER = 36
PID = struct.Struct("<q")
LOADED = 0
"""Reply in place of a pid: the server has loaded."""

PROGRAM = ("-m", "services.supervisor.forkserver")
NAME = "ltv-forkserver"
MAX_REQUEST_BYTES = 65_536
DESCRIPTORS = 2
REPLY_TIMEOUT_S, LOADING_REPLY_TIMEOUT_S = 2.0, 20.0
"""A fork takes about 10 ms, about 100 ms on a busy machine; of a server that starts or loads, up to some seconds there.
A server that does not reply in time is killed."""
POLL_S = 0.1

ADOPTION_TIMEOUT_S = 2.0  # a child waits at most this long for its new parent, which may have died
PIPE_BYTES = 1 << 20  # a state fits into the pipe, so that a stopped child does not block the supervisor


class Request(msgspec.Struct, frozen=True):
    """Request to fork a process; without a module, to load."""

    module: str = ""
    config: str = ""
    log: str = ""


# --- the supervisor's end --------------------------------------------------------------------------------------------


class Forked(NamedTuple):
    """Child process of the supervisor, and the supervisor's ends of the two pipes to it."""

    pid: int
    stdin: int
    heartbeat: int


class ForkServer:
    """Handle of the fork server; one that dies or does not answer is replaced.

    Construct it in the main thread: the server and its children end with that thread (parent_death.py). ``group`` is
    the process group of all of them; ``stop`` ends a wait for a reply.
    """

    def __init__(self, scenario: Path, log: Path, group: int, stop: Callable[[], bool] = lambda: False) -> None:
        self.log = log
        self._stop = stop
        self._scenario = scenario
        self._group = group
        self._loads = False
        _set_subreaper(True)
        self._start()

    def _start(self) -> None:
        self._loaded = False
        self._requests, server_socket = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        arguments = map(str, (os.getpid(), server_socket.fileno(), self._scenario, self._group))
        with server_socket, self.log.open("ab") as output:
            self._process = subprocess.Popen(
                [sys.executable, "-P", *PROGRAM, *arguments],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                process_group=0,
                pass_fds=(server_socket.fileno(),),
            )

    @property
    def pid(self) -> int:
        """Process id of the fork server."""
        return self._process.pid

    def exit_code(self) -> int | None:
        """Return the exit code of the fork server; None while it runs."""
        return self._process.poll()

    def load(self) -> None:
        """Begin to load what the processes of the scenario use."""
        self._loads = True
        with contextlib.suppress(OSError):
            self._requests.send(msgspec.json.encode(Request()))

    def is_loaded(self) -> bool:
        """Return True if the server has loaded. One that is stopped is replaced."""
        if self._is_stopped():
            self._replace()
        if not self._loaded and select.select([self._requests], [], [], 0.0)[0]:
            self._loaded = self._reply() == LOADED
        return self._loaded

    def replace_if_dead(self) -> None:
        """Start another server if this one is dead or stopped."""
        if self.exit_code() is not None or self._is_stopped():
            self._replace()

    def fork(self, module: str, config: Path, log: Path) -> Forked:
        """Fork a child. Raises ``ChildProcessError`` if neither this server nor another one replies in time, and
        ``InterruptedError`` after a stop request.
        """
        request = msgspec.json.encode(Request(module, str(config), str(log)))
        for _ in range(2):
            stdin, into_stdin = os.pipe()
            heartbeats, heartbeat = os.pipe()
            with contextlib.suppress(OSError):  # more than this user is allowed
                fcntl.fcntl(into_stdin, fcntl.F_SETPIPE_SZ, PIPE_BYTES)
            os.set_blocking(heartbeats, False)
            pid = self._request_fork(request, (stdin, heartbeat))
            os.close(stdin)
            os.close(heartbeat)
            if pid is not None:
                return Forked(pid, into_stdin, heartbeats)
            os.close(into_stdin)  # a child that was forked too late ends at the end of its input
            os.close(heartbeats)
            if self._stop():
                raise InterruptedError
            self._replace()
        raise ChildProcessError(f"{module} is not started: the fork server does not answer")

    def close(self) -> None:
        """Kill the server; its children live on."""
        self._end()
        _set_subreaper(False)

    def _replace(self) -> None:
        self._end()
        self._start()
        if self._loads:
            self.load()

    def _is_stopped(self) -> bool:
        try:
            return Path(f"/proc/{self.pid}/stat").read_text(errors="replace").rpartition(")")[2].split()[0] == "T"
        except OSError:
            return False

    def _end(self) -> None:
        self._requests.close()
        self._process.kill()
        self._process.wait()

    def _request_fork(self, request: bytes, descriptors: tuple[int, int]) -> int | None:
        """Return the pid of the child; None if the server does not reply in time or is stopped, or after a request."""
        with contextlib.suppress(ConnectionError):  # the server has died
            socket.send_fds(self._requests, [request], descriptors)
            until = time.monotonic() + (REPLY_TIMEOUT_S if self._loaded else LOADING_REPLY_TIMEOUT_S)
            while time.monotonic() < until and not self._stop() and not self._is_stopped():
                if select.select([self._requests], [], [], POLL_S)[0]:
                    if (pid := self._reply()) != LOADED:
                        return pid
                    self._loaded = True
        return None

    def _reply(self) -> int | None:
        """Return the next reply; None if the server has died."""
        with contextlib.suppress(ConnectionError):
            if data := self._requests.recv(PID.size):
                return int(PID.unpack(data)[0])
        return None


def _set_subreaper(on: bool) -> None:
    """Make this process adopt, or no longer adopt, its orphaned descendants."""
    ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, int(on), 0, 0, 0)


# --- the server ------------------------------------------------------------------------------------------------------


def main() -> None:
    """Serve requests. ``sys.argv``: the parent's pid, the socket to it, the scenario, the group of the children."""
    parent, channel, scenario, group = sys.argv[1:]
    die_with_parent(int(parent))
    with contextlib.suppress(OSError):  # the orphan cleanup has died before any child was started
        os.setpgid(0, int(group))
    entry_point.name_process(NAME)
    loading: Iterator[None] | None = None
    with socket.socket(fileno=int(channel)) as requests:
        while True:
            if loading is not None and not select.select([requests], [], [], 0.0)[0]:
                if next(loading, LOADED) == LOADED:
                    loading = None
                    requests.send(PID.pack(LOADED))
                continue
            data, descriptors, _, _ = socket.recv_fds(requests, MAX_REQUEST_BYTES, DESCRIPTORS)
            if not data:
                return
            request = msgspec.json.decode(data, type=Request)
            if request.module:
                requests.send(PID.pack(_fork(int(parent), request, descriptors, requests)))
            else:
                loading = load(scenario)


def load(scenario: str) -> Iterator[None]:
    """Import what the processes of this scenario use, and warm up its nodes; at each step the server may fork."""
    import services.processes.recorder
    import services.processes.router  # noqa: F401

    yield
    from services.run.run_config import resolve
    from services.supervisor import jit_cache

    run_config = resolve(scenario)
    yield
    jit_cache.warm_up_controller(run_config)
    yield
    jit_cache.warm_up_others(run_config)
    gc.collect()
    gc.freeze()  # so that a child's garbage collection does not copy the shared pages


def _fork(parent: int, request: Request, descriptors: list[int], requests: socket.socket) -> int:
    """Fork a child of ``parent``. Return its pid."""
    reading, writing = os.pipe()
    intermediate_pid = os.fork()
    if intermediate_pid == 0:
        try:
            pid = os.fork()
            if pid == 0:
                for fd in (reading, writing):
                    os.close(fd)
                requests.close()
                _run_child(parent, request, descriptors)
            os.write(writing, PID.pack(pid))
        finally:
            os._exit(0)
    for fd in (writing, *descriptors):
        os.close(fd)
    with os.fdopen(reading, "rb") as reply:
        (pid,) = PID.unpack(reply.read(PID.size))
    os.waitpid(intermediate_pid, 0)
    return int(pid)


def _run_child(parent: int, request: Request, descriptors: list[int]) -> NoReturn:
    """Run the requested child to its end."""
    code = 1
    try:
        stdin, heartbeat = descriptors
        log = os.open(request.log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o666)
        for number, target_fd in ((stdin, 0), (log, 1), (log, 2)):
            os.dup2(number, target_fd)
        os.close(stdin)
        os.close(log)
        until = time.monotonic() + ADOPTION_TIMEOUT_S
        while os.getppid() != parent and time.monotonic() < until:
            time.sleep(0.001)
        code = entry_point.run(str(parent), request.module, request.config, str(heartbeat))
    except SystemExit as stop:
        code = stop.code if isinstance(stop.code, int) else int(stop.code is not None)
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


if __name__ == "__main__":
    main()
