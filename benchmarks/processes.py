"""Child processes of a benchmark; none of them outlives it."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import IO

from services.supervisor.loopback import is_listening
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
    """Return when a router listens at the endpoint, or after ``ROUTER_S``."""
    until = time.monotonic() + ROUTER_S
    while not is_listening(endpoint) and time.monotonic() < until:
        time.sleep(0.02)


def children(parent: int) -> Iterator[tuple[int, str]]:
    """List pid and name of every live process that ``parent`` has started."""
    for folder in Path("/proc").iterdir():
        if not folder.name.isdigit():
            continue
        try:
            name, _, rest = (folder / "stat").read_text(encoding="utf-8", errors="replace").rpartition(")")
        except OSError:  # it has ended meanwhile
            continue
        state, ppid = rest.split()[:2]
        if int(ppid) == parent and state != "Z":
            yield int(folder.name), name.partition("(")[2]
