"""Fork server: a process that starts the processes of a run as forks of itself, once it has loaded what they need.

This file holds the supervisor's handle and the server's program.

It makes starts and restarts quicker, because a forked process need not import and load compiled code: a failed
estimator or controller must be back within 3 s (docs/restarts.md). Measured times are in docs/notes/process-start.md.
The server is the same after a fork, so the second restart is as quick as the first. It also forks a spare server, which
takes its place if it dies or does not reply: a fork shares the memory, and loads nothing. A child is spawned, which
takes longer, while no server has loaded, as the router, which is the first of all, or if the spare fails too.

    reply     0: the server has loaded
    request   module, config and log (JSON), with the child's standard input, which holds the state to continue from,
              and its lifeline (descriptors); or null, with the socket of the requests to the spare
    reply     the pid of the child, or of the spare

The server has one thread and opens no Zenoh session, so no lock is held during a fork. It forks twice, and the process
in between ends at once. The supervisor, as the nearest subreaper, then adopts the child: it can wait for it, and the
child dies with it. If the server dies, its children live on, and another one takes its place. The standard library's
fork server stays the parent of its children: they would die with it, or outlive the supervisor.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import select
import socket
import struct
import sys
import time
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

import msgspec

from services.runtime.lifeline import GO
from services.supervisor import entry_point
from services.supervisor.child import Child
from services.supervisor.parent_death import die_with_parent

PR_SET_CHILD_SUBREAPER = 36
PID = struct.Struct("<q")
LOADED = 0

PYTHON = (sys.executable, "-P")
PROGRAM = ("-m", "services.supervisor.forkserver")
ENTRY_POINT = ("-m", "services.supervisor.entry_point")
NAME, SPARE = "ltv-forkserver", "ltv-forkspare"
MAX_REQUEST_BYTES = 65_536
DESCRIPTORS = 2
REPLY_TIMEOUT_S = 0.5
"""A fork takes about 10 ms, about 100 ms on a busy machine. A server that does not reply in time is killed."""

ADOPTION_TIMEOUT_S = 2.0  # a child waits at most this long for its new parent, which may have died


# --- the supervisor's end --------------------------------------------------------------------------------------------


class Server(Child):
    """Fork server, with the socket of the requests to it."""

    def __init__(self, pid: int, requests: socket.socket) -> None:
        super().__init__(pid)
        self._requests = requests

    def reply(self, timeout_s: float) -> int | None:
        """Return its next reply; None if there is none in time or it has died."""
        with contextlib.suppress(ConnectionError):
            if select.select([self._requests], [], [], timeout_s)[0] and (data := self._requests.recv(PID.size)):
                return int(PID.unpack(data)[0])
        return None

    def fork(self, request: tuple[str, str, str] | None, descriptors: Sequence[int]) -> int | None:
        """Return the pid of what it forks; None if it does not reply in time."""
        with contextlib.suppress(ConnectionError):  # it has died
            socket.send_fds(self._requests, [msgspec.json.encode(request)], descriptors)
        return self.reply(REPLY_TIMEOUT_S)

    def close(self) -> None:
        """Kill it; its children live on."""
        self._requests.close()
        self.kill()
        super().close()


class ForkServer:
    """Handle of the fork server and of its spare, and of another one in their place if both die.

    Construct it in the main thread: the server and its children end with that thread (parent_death.py). ``group`` is
    the process group of all of them.
    """

    def __init__(self, scenario: Path, log: Path, group: int) -> None:
        self.log = log
        self.servers: list[Server] = []
        """The one in use and its spare."""
        self._scenario = scenario
        self._group = group
        self._loaded = False
        _set_subreaper(True)

    def load(self) -> None:
        """Start a server, unless one runs; it loads what the processes of the scenario use. Then start its spare."""
        for server in [one for one in self.servers if one.exit_code() is not None]:
            self._end(server)
        if self.servers and (len(self.servers) > 1 or not self.is_loaded()):
            return
        requests, server_socket = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with server_socket:
            fd = server_socket.fileno()
            if self.servers:
                pid = self.servers[0].fork(None, (fd,))
            else:
                words = (*PROGRAM, str(os.getpid()), str(fd), str(self._scenario), str(self._group))
                no_input = os.POSIX_SPAWN_OPEN, 0, os.devnull, os.O_RDONLY, 0
                pid = _spawned(words, self.log, os.O_APPEND, 0, no_input, (os.POSIX_SPAWN_DUP2, fd, fd))
        if pid is None:
            requests.close()
            self._end(self.servers[0])
        else:
            self.servers.append(Server(pid, requests))

    def exit_code(self) -> int | None:
        """Return the exit code of the server; None while it runs, or if none was started."""
        return self.servers[0].exit_code() if self.servers else None

    def is_loaded(self) -> bool:
        """Return True if the server has loaded."""
        self._loaded = self._loaded or (bool(self.servers) and self.servers[0].reply(0.0) == LOADED)
        return self._loaded

    def start(self, module: str, config: Path, log: Path, state: bytes = b"") -> tuple[int, int]:
        """Start a child: forked by the server, or by its spare, or spawned if none has loaded, or replies in time.

        Return its pid and the supervisor's end of its lifeline.
        """
        stdin = os.memfd_create("state")
        os.write(stdin, state)
        heartbeats, lifeline = (end.detach() for end in socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET))
        os.set_blocking(heartbeats, False)
        try:
            if self.is_loaded():
                pid = self.servers[0].fork((module, str(config), str(log)), (stdin, lifeline))
            else:
                # The second action makes the descriptor inheritable.
                actions = (os.POSIX_SPAWN_DUP2, stdin, 0), (os.POSIX_SPAWN_DUP2, lifeline, lifeline)
                words = (*ENTRY_POINT, str(os.getpid()), module, str(config), str(lifeline))
                pid = _spawned(words, log, os.O_TRUNC, self._group, *actions)
        finally:
            os.close(stdin)
            os.close(lifeline)
        if pid is not None:
            with contextlib.suppress(BrokenPipeError):  # the child is already dead, which is noticed elsewhere
                os.write(heartbeats, GO)
            return pid, heartbeats
        os.close(heartbeats)  # a child that the server has forked too late ends at the end of its lifeline
        self._end(self.servers[0])
        return self.start(module, config, log, state)  # without that server

    def close(self) -> None:
        """Kill the servers; their children live on."""
        for server in tuple(self.servers):
            self._end(server)
        _set_subreaper(False)

    def _end(self, server: Server) -> None:
        """Kill a server. Its spare has loaded."""
        self.servers.remove(server)
        server.close()
        self._loaded = self._loaded and bool(self.servers)


def _spawned(words: Sequence[str], log: Path, how: int, group: int, *actions: tuple[Any, ...]) -> int:
    """Return the pid of a spawned Python program, whose output goes into ``log``; in a ``group`` of its own for 0."""
    output = [(os.POSIX_SPAWN_OPEN, 1, str(log), os.O_WRONLY | os.O_CREAT | how, 0o666), (os.POSIX_SPAWN_DUP2, 1, 2)]
    arguments = [*PYTHON, *words]
    return os.posix_spawn(sys.executable, arguments, os.environ, file_actions=[*actions, *output], setpgroup=group)


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
    requests = socket.socket(fileno=int(channel))
    requests.send(PID.pack(LOADED))
    serve(int(parent), requests)


def serve(parent: int, requests: socket.socket) -> None:
    """Fork what is requested until the supervisor closes the socket."""
    while data := (received := socket.recv_fds(requests, MAX_REQUEST_BYTES, DESCRIPTORS))[0]:
        request = msgspec.json.decode(data, type=tuple[str, str, str] | None)
        requests.send(PID.pack(_fork(parent, request, received[1], requests)))


def load(scenario: str) -> None:
    """Import what the processes of this scenario use, and warm up its nodes."""
    import services.processes.recorder
    import services.processes.router  # noqa: F401
    from services.run.run_config import resolve
    from services.supervisor import jit_cache

    jit_cache.warm_up(resolve(scenario))
    gc.collect()
    gc.freeze()  # so that a child's garbage collection does not copy the shared pages


def _fork(parent: int, request: tuple[str, str, str] | None, descriptors: list[int], requests: socket.socket) -> int:
    """Fork a child of ``parent``, without a request the spare of this server. Return its pid."""
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


def _run_child(parent: int, request: tuple[str, str, str] | None, descriptors: list[int]) -> NoReturn:
    """Run the requested child, or the spare, to its end."""
    code = 1
    try:
        until = time.monotonic() + ADOPTION_TIMEOUT_S
        while os.getppid() != parent and time.monotonic() < until:
            time.sleep(0.001)
        if request is None:
            die_with_parent(parent)
            entry_point.name_process(SPARE)
            serve(parent, socket.socket(fileno=descriptors[0]))
            os._exit(0)
        (module, config, log), (stdin, lifeline) = request, descriptors
        output = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o666)
        for number, target_fd in ((stdin, 0), (output, 1), (output, 2)):
            os.dup2(number, target_fd)
        os.close(stdin)
        os.close(output)
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
