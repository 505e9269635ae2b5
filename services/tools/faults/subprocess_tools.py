"""Child processes of a campaign; none of them outlives it."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from services.supervisor.parent_death import OrphanCleanup

Process = subprocess.Popen[bytes]


class Started:
    """Context manager of child processes, which kills those that still run at its end or when this process dies."""

    def __init__(self) -> None:
        self._cleanup = OrphanCleanup()
        self._processes: list[Process] = []

    def __enter__(self) -> Started:
        return self

    def __exit__(self, *_: object) -> None:
        for process in self._processes:
            if process.poll() is None:
                process.kill()
                process.wait()
            self._cleanup.remove(process.pid)
        self._cleanup.close()

    def start(self, words: Sequence[str], log: Path, *, results: bool) -> Process:
        """Start ``python -m WORDS``, its stderr in ``log``; ``results``: what it writes on standard output too."""
        with log.open("wb") as output:
            process = subprocess.Popen(
                [sys.executable, "-P", "-m", *words],
                stdin=subprocess.DEVNULL,
                stdout=output if results else subprocess.DEVNULL,
                stderr=subprocess.STDOUT if results else output,
                start_new_session=True,
            )
        self._cleanup.add(process.pid)
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
