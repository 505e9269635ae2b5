"""Child processes of a benchmark; none of them outlives it."""

from __future__ import annotations

import socket
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import IO

from services.supervisor.parent_death import OrphanCleanup

Process = subprocess.Popen[bytes]
File = IO[bytes] | int

ROUTER_S = 20.0
"""Longest wait until a router listens."""


class Started:
    """Context manager of child processes, which kills those that still run at its end or when this process dies."""

    def __init__(self) -> None:
        self._cleanup = OrphanCleanup()
        self._processes: list[Process] = []

    def __enter__(self) -> Started:
        return self

    def __exit__(self, *_: object) -> None:
        for process in self._processes:
            process.kill()
            with process:  # closes its pipes, and waits
                pass
        self._cleanup.close()

    def start(
        self,
        *words: str,
        stdin: File = subprocess.DEVNULL,
        stdout: File = subprocess.DEVNULL,
        stderr: File | None = subprocess.DEVNULL,
    ) -> Process:
        """Start ``python -m WORDS``; an interrupt from the terminal does not reach it."""
        command = [sys.executable, "-m", *words]
        group = self._cleanup.group
        process = subprocess.Popen(command, stdin=stdin, stdout=stdout, stderr=stderr, process_group=group)
        self._processes.append(process)
        return process


def end(process: Process, within_s: float) -> int | None:
    """Ask a process to stop. Return its exit code, or None if it had to be killed."""
    process.terminate()
    with suppress(subprocess.TimeoutExpired):
        return process.wait(within_s)
    process.kill()
    process.wait()
    return None


def await_router(endpoint: str) -> None:
    """Return when a router listens at the endpoint PROTOCOL/HOST:PORT, or after ``ROUTER_S``."""
    host, _, port = endpoint.partition("/")[2].rpartition(":")
    until = time.monotonic() + ROUTER_S
    while time.monotonic() < until:
        with suppress(OSError):
            return socket.create_connection((host, int(port)), timeout=0.2).close()
        time.sleep(0.02)


def descendants(root: int) -> dict[int, str]:
    """Return the names of the live process ``root``, "supervisor", and of all that it and its children have started."""
    rows: dict[int, tuple[int, str]] = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            name, _, rest = stat.read_text(errors="replace").partition("(")[2].rpartition(")")
        except OSError:  # it has ended meanwhile
            continue
        state, parent = rest.split()[:2]
        if state != "Z":
            rows[int(stat.parent.name)] = int(parent), name
    found = {root: "supervisor"} if root in rows else {}
    for pid, (parent, name) in sorted(rows.items()):
        if parent in found:
            found[pid] = name
    return found
