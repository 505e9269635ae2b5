"""Fork server: a process that starts the processes of a run as forks of itself, once it has loaded what they need.

This file holds the supervisor's handle and the server's program.

It makes starts and restarts quicker, because a forked process need not import and load compiled code: a failed
estimator or controller must be back within 3 s (docs/restarts.md). Measured times are in docs/notes/process-start.md.
The server is the same after a fork, so the second restart is as quick as the first. A child is spawned instead, which
takes longer, while no server has loaded, as the router, which is the first of all, or if the server does not reply.

    reply     0: the server has loaded
    request   module, config and log (JSON), with the child's standard input and lifeline (descriptors)
    reply     the child's pid

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
from pathlib import Path
from typing import NamedTuple, NoReturn

import msgspec

from services.supervisor import entry_point
from services.supervisor.parent_death import die_with_parent

PR_SET_CHILD_SUBREAPER = 36
PID = struct.Struct("<q")
LOADED = 0

PYTHON = (sys.executable, "-P")
PROGRAM = ("-m", "services.supervisor.forkserver")
ENTRY_POINT = ("-m", "services.supervisor.entry_point")
NAME = "ltv-forkserver"
MAX_REQUEST_BYTES = 65_536
DESCRIPTORS = 2
REPLY_TIMEOUT_S = 1.0
"""A fork takes about 10 ms, about 100 ms on a busy machine. A server that does not reply in time is killed."""

ADOPTION_TIMEOUT_S = 2.0  # a child waits at most this long for its new parent, which may have died
PIPE_BYTES = 1 << 20  # a state fits into the pipe, so that a stopped child does not block the supervisor


# --- the supervisor's end --------------------------------------------------------------------------------------------


class Child(NamedTuple):
    """Child process of the supervisor, and the supervisor's ends of its standard input and its lifeline."""

    pid: int
    stdin: int
    heartbeats: int


class ForkServer:
    """Handle of the fork server, and of another one in its place if it dies.

    Construct it in the main thread: the server and its children end with that thread (parent_death.py). ``group`` is
    the process group of all of them.
    """

    def __init__(self, scenario: Path, log: Path, group: int) -> None:
        self.log = log
        self._scenario = scenario
        self._group = group
        self._process: subprocess.Popen[bytes] | None = None
        self._requests: socket.socket
        self._loaded = False
        _set_subreaper(True)

    def load(self) -> None:
        """Start a server, unless one runs; it loads what the processes of the scenario use."""
        if self._process is not None and self.exit_code() is None:
            return
        self._end()
        self._requests, server_socket = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        arguments = map(str, (os.getpid(), server_socket.fileno(), self._scenario, self._group))
        with server_socket, self.log.open("ab") as output:
            self._process = subprocess.Popen(
                [*PYTHON, *PROGRAM, *arguments],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                process_group=0,
                pass_fds=(server_socket.fileno(),),
            )

    @property
    def pid(self) -> int:
        """Process id of the fork server; 0 if none was started."""
        return 0 if self._process is None else self._process.pid

    def exit_code(self) -> int | None:
        """Return the exit code of the fork server; None while it runs, or if none was started."""
        return None if self._process is None else self._process.poll()

    def is_loaded(self) -> bool:
        """Return True if the server has loaded."""
        self._loaded = self._loaded or (self.pid != 0 and self._reply(0.0) == LOADED)
        return self._loaded

    def start(self, module: str, config: Path, log: Path) -> Child:
        """Start a child: forked by the server, or spawned if the server has not loaded, or does not reply in time."""
        stdin, into_stdin = os.pipe()
        heartbeats, lifeline = (end.detach() for end in socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET))
        with contextlib.suppress(OSError):  # more than this user is allowed
            fcntl.fcntl(into_stdin, fcntl.F_SETPIPE_SZ, PIPE_BYTES)
        os.set_blocking(heartbeats, False)
        try:
            begin = self._fork if self.is_loaded() else self._spawn
            pid = begin(module, str(config), str(log), stdin, lifeline)
        finally:
            os.close(stdin)
            os.close(lifeline)
        if pid is not None:
            return Child(pid, into_stdin, heartbeats)
        os.close(into_stdin)  # a child that the server has forked too late ends at the end of its input
        os.close(heartbeats)
        return self.start(module, config, log)  # without that server

    def close(self) -> None:
        """Kill the server; its children live on."""
        self._end()
        _set_subreaper(False)

    def _fork(self, module: str, config: str, log: str, stdin: int, lifeline: int) -> int | None:
        """Return the pid of a forked child; None if the server does not reply in time: it is killed then."""
        with contextlib.suppress(ConnectionError):  # the server has died
            socket.send_fds(self._requests, [msgspec.json.encode((module, config, log))], (stdin, lifeline))
        pid = self._reply(REPLY_TIMEOUT_S)
        if pid is None:
            self._end()
        return pid

    def _spawn(self, module: str, config: str, log: str, stdin: int, lifeline: int) -> int:
        """Return the pid of a spawned child."""
        arguments = [*PYTHON, *ENTRY_POINT, str(os.getpid()), module, config, str(lifeline)]
        actions = [
            (os.POSIX_SPAWN_DUP2, stdin, 0),
            (os.POSIX_SPAWN_OPEN, 1, log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o666),
            (os.POSIX_SPAWN_DUP2, 1, 2),
            (os.POSIX_SPAWN_DUP2, lifeline, lifeline),  # which makes it inheritable
        ]
        return os.posix_spawn(sys.executable, arguments, os.environ, file_actions=actions, setpgroup=self._group)

    def _reply(self, timeout_s: float) -> int | None:
        """Return the next reply; None if there is none in time or the server has died."""
        with contextlib.suppress(ConnectionError):
            if select.select([self._requests], [], [], timeout_s)[0] and (data := self._requests.recv(PID.size)):
                return int(PID.unpack(data)[0])
        return None

    def _end(self) -> None:
        if self._process is not None:
            self._requests.close()
            self._process.kill()
            self._process.wait()
        self._process, self._loaded = None, False


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
    load(scenario)
    with socket.socket(fileno=int(channel)) as requests:
        requests.send(PID.pack(LOADED))
        while True:
            data, descriptors, _, _ = socket.recv_fds(requests, MAX_REQUEST_BYTES, DESCRIPTORS)
            if not data:
                return
            request = msgspec.json.decode(data, type=tuple[str, str, str])
            requests.send(PID.pack(_fork(int(parent), request, descriptors, requests)))


def load(scenario: str) -> None:
    """Import what the processes of this scenario use, and warm up its nodes."""
    import services.processes.recorder
    import services.processes.router  # noqa: F401
    from services.run.run_config import resolve
    from services.supervisor import jit_cache

    jit_cache.warm_up(resolve(scenario))
    gc.collect()
    gc.freeze()  # so that a child's garbage collection does not copy the shared pages


def _fork(parent: int, request: tuple[str, str, str], descriptors: list[int], requests: socket.socket) -> int:
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
                _run_child(parent, *request, *descriptors)
            os.write(writing, PID.pack(pid))
        finally:
            os._exit(0)
    for fd in (writing, *descriptors):
        os.close(fd)
    with os.fdopen(reading, "rb") as reply:
        (pid,) = PID.unpack(reply.read(PID.size))
    os.waitpid(intermediate_pid, 0)
    return int(pid)


def _run_child(parent: int, module: str, config: str, log: str, stdin: int, lifeline: int) -> NoReturn:
    """Run the requested child to its end."""
    code = 1
    try:
        output = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o666)
        for number, target_fd in ((stdin, 0), (output, 1), (output, 2)):
            os.dup2(number, target_fd)
        os.close(stdin)
        os.close(output)
        until = time.monotonic() + ADOPTION_TIMEOUT_S
        while os.getppid() != parent and time.monotonic() < until:
            time.sleep(0.001)
        code = entry_point.run(str(parent), module, config, str(lifeline))
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
