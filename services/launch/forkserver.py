"""A process that has loaded what the others of a run will need, and forks them.

Imports, compiled code, solvers and settings take some two seconds; a fork of a process that has them takes some ten
milliseconds. So a dead process is replaced at once, as often as need be, and six of them start in the time of one and
share its memory. It has one thread and has opened no session, so a fork finds every lock free.

    request   the command line and the place of the log (JSON), with the child's standard input and
              its pulse (descriptors)
    answer    the child's pid; the first one, ``LOADED``, says that it is ready

A child is forked twice, and who stands between ends at once: so the supervisor, as the nearest subreaper, becomes its
parent, waits for it, and is outlived by it no more than by a child that it has spawned itself. The fork server may die
without anyone else.
"""

from __future__ import annotations

import gc
import os
import socket
import struct
import sys
import time
import traceback
from typing import NoReturn

import msgspec

from services.launch import child
from services.launch.orphans import die_with_parent

PID = struct.Struct("<q")
LOADED = 0
"""In place of a pid."""

MOST_BYTES = 65_536  # of a request
DESCRIPTORS = 2
ADOPTION_S = 2.0  # at most so long a child waits for its new parent, who may be no more
NAME = "ltv-forkserver"


class Request(msgspec.Struct, frozen=True):
    """Who is to be forked, by its command line of ``ltv-mpc``."""

    command: tuple[str, ...]
    log: str


def main() -> None:
    """``sys.argv``: the parent's pid, the descriptor of the socket to it, the scenario, room for a command line."""
    parent, channel, scenario, _ = sys.argv[1:]
    die_with_parent(int(parent))
    child.call_oneself(NAME)
    room = child.Room()
    room.write([*sys.orig_argv[:4], parent, scenario])
    load(scenario)
    gc.collect()
    gc.freeze()  # no collection of a child writes to what all share
    with socket.socket(fileno=int(channel)) as requests:
        requests.send(PID.pack(LOADED))
        while True:
            data, descriptors, _, _ = socket.recv_fds(requests, MOST_BYTES, DESCRIPTORS)
            if not data:
                return
            pid = _fork(int(parent), msgspec.json.decode(data, type=Request), descriptors, requests, room)
            requests.send(PID.pack(pid))


def load(scenario: str) -> None:
    """Import what the processes of this scenario use, and rehearse its nodes and the command line."""
    import services.nodes.recorder
    import services.nodes.router  # noqa: F401
    from services.cli import app
    from services.launch import warm

    warm.rehearse(scenario)
    app.run(["--version"])  # builds all commands, and imports what the first call of one imports


def _fork(parent: int, request: Request, descriptors: list[int], requests: socket.socket, room: child.Room) -> int:
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
                _become(parent, request, descriptors, room)
            os.write(say, PID.pack(pid))
        finally:
            os._exit(0)
    for end in (say, *descriptors):
        os.close(end)
    with os.fdopen(said, "rb") as answer:
        (pid,) = PID.unpack(answer.read(PID.size))
    os.waitpid(between, 0)
    return int(pid)


def _become(parent: int, request: Request, descriptors: list[int], room: child.Room) -> NoReturn:
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
        words = [str(parent), *request.command, f"{child.PULSE}{pulse}"]
        room.write([sys.executable, "-P", "-m", child.__name__, *words])
        child.run(words)
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
