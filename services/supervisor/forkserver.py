"""Fork server: a process that has loaded what the processes of a run need, and forks them.

This file holds the supervisor's handle and the server's program.

It makes starts and restarts quicker, because a forked process need not import and load compiled code: a failed
estimator or controller must be back within 2 s (docs/restarts.md), which spawning often misses. Measured times are in
docs/notes/process-start.md. The server is the same after a fork, so the second restart is as quick as the first.

    request   module, config and log (JSON), with the child's standard input and heartbeat pipe (descriptors)
    reply     the child's pid; the first reply, ``LOADED``, says that the server is ready

The server has one thread and opens no Zenoh session, so no lock is held during a fork. It forks twice, and the process
in between ends at once. The supervisor, as the nearest subreaper, then adopts the child: it can wait for it, and the
child dies with it, as a spawned one does. If the server dies, its children live on.
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
"""Reply in place of a pid: the server is ready."""

PROGRAM = ("-m", "services.supervisor.forkserver")
NAME = "ltv-forkserver"
MAX_REQUEST_BYTES = 65_536
DESCRIPTORS = 2
REPLY_TIMEOUT_S = 2.0
"""A fork takes about 10 ms, about 100 ms on a busy machine. A server that does not reply in time is killed."""

ADOPTION_TIMEOUT_S = 2.0  # a child waits at most this long for its new parent, which may have died


class Request(msgspec.Struct, frozen=True):
    """Request to fork a process."""

    module: str
    config: str
    log: str


# --- the supervisor's end --------------------------------------------------------------------------------------------


def is_supported() -> bool:
    """Return True if the system has ``prctl`` and ``pidfd_open``: Linux, but not every emulation of it."""
    if sys.platform != "linux" or not hasattr(ctypes.CDLL(None), "prctl"):
        return False
    try:
        os.close(os.pidfd_open(os.getpid()))
    except OSError:
        return False
    return True


class ForkServer:
    """Handle of a fork server, which begins to load on construction.

    Construct it in the main thread: the server and its children end with that thread (parent_death.py).
    """

    def __init__(self, scenario: Path, log: Path, cleanup: OrphanCleanup) -> None:
        self.log = log
        self.loaded = False
        self._cleanup = cleanup
        _set_subreaper(True)
        self._requests, server_socket = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with server_socket, log.open("wb") as output:
            self._process = subprocess.Popen(
                [sys.executable, "-P", *PROGRAM, str(os.getpid()), str(server_socket.fileno()), str(scenario)],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                pass_fds=(server_socket.fileno(),),
            )
        cleanup.add(self._process.pid)

    @property
    def pid(self) -> int:
        """Process id of the fork server."""
        return self._process.pid

    def exit_code(self) -> int | None:
        """Return the exit code of the fork server; None while it runs."""
        return self._process.poll()

    def is_loaded(self) -> bool:
        """Return True if the server has loaded and can fork."""
        if not self.loaded and self._has_reply(0.0):
            self.loaded = self._reply() == LOADED
        return self.loaded

    def fork(self, module: str, config: Path, log: Path, stdin: int, heartbeat: int) -> ForkedProcess | None:
        """Fork a child. Return None if the server has not loaded yet, is dead, or does not reply in time."""
        if not self.is_loaded():
            return None
        request = msgspec.json.encode(Request(module, str(config), str(log)))
        try:
            socket.send_fds(self._requests, [request], [stdin, heartbeat])
            pid = self._reply() if self._has_reply(REPLY_TIMEOUT_S) else None
        except OSError:
            pid = None
        if pid is None:
            self.loaded = False
            self._process.kill()
            return None
        return ForkedProcess(pid)

    def close(self) -> None:
        """Kill the server; its children live on."""
        self._requests.close()
        self._process.kill()
        self._process.wait()
        self._cleanup.remove(self._process.pid)
        _set_subreaper(False)

    def _has_reply(self, within_s: float) -> bool:
        return bool(select.select([self._requests], [], [], within_s)[0])

    def _reply(self) -> int | None:
        data = self._requests.recv(PID.size)
        return int(PID.unpack(data)[0]) if data else None


class ForkedProcess:
    """Handle of a forked child, with the methods of ``subprocess.Popen``."""

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self._code: int | None = None
        self._pidfd = os.pidfd_open(pid)

    def poll(self) -> int | None:
        """Return the exit code, or minus the number of the signal that ended the child; None while it runs."""
        if self._code is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                self._code = os.waitstatus_to_exitcode(status)
                os.close(self._pidfd)
        return self._code

    def wait(self, timeout: float | None = None) -> int:
        """Wait for the exit and return the exit code. Raises ``subprocess.TimeoutExpired``."""
        if self._code is None:
            poller = select.poll()
            poller.register(self._pidfd, select.POLLIN)
            poller.poll(None if timeout is None else 1000.0 * timeout)
        code = self.poll()
        if code is None:
            raise subprocess.TimeoutExpired("a forked process", timeout or 0.0)
        return code

    def send_signal(self, number: int) -> None:
        """Send a signal if the child runs. Its pid is not reused before it was waited for."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        """Send SIGKILL."""
        self.send_signal(signal.SIGKILL)


def _set_subreaper(on: bool) -> None:
    """Make this process adopt, or no longer adopt, its orphaned descendants."""
    ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, int(on), 0, 0, 0)


# --- the server ------------------------------------------------------------------------------------------------------


def main() -> None:
    """Serve requests. ``sys.argv``: the parent's pid, the descriptor of the socket to it, the scenario."""
    parent, channel, scenario = sys.argv[1:]
    die_with_parent(int(parent))
    entry_point.name_process(NAME)
    load(scenario)
    gc.collect()
    gc.freeze()  # so that a child's garbage collection does not copy the shared pages
    with socket.socket(fileno=int(channel)) as requests:
        requests.send(PID.pack(LOADED))
        while True:
            data, descriptors, _, _ = socket.recv_fds(requests, MAX_REQUEST_BYTES, DESCRIPTORS)
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
        os.setsid()
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
