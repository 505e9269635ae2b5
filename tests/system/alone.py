"""A router and a controller as processes of their own, as a user starts them, for whoever speaks to them."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from queue import Empty, SimpleQueue

CLI = (sys.executable, "-P", "-m", "services.cli")
PATIENCE_S = 120.0


class Lines:
    """What a process says, line by line as it comes."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process
        self._lines: SimpleQueue[str] = SimpleQueue()
        self.said: list[str] = []
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self._lines.put(line)

    def until(self, wanted: Callable[[str], bool], within_s: float = PATIENCE_S) -> str:
        """The first line for which ``wanted`` is true, of those that were not looked at yet."""
        deadline = time.monotonic() + within_s
        while (left := deadline - time.monotonic()) > 0:
            try:
                line = self._lines.get(timeout=min(left, 0.5))
            except Empty:
                if self._process.poll() is None:
                    continue
                break
            self.said.append(line)
            if wanted(line):
                return line
        raise AssertionError(f"it never came to that; ended with {self._process.poll()}:\n" + "".join(self.said[-20:]))


@contextmanager
def started(*command: str, cwd: Path | None = None) -> Iterator[tuple[subprocess.Popen[str], Lines]]:
    """A process and its words (both streams), ended with the block."""
    process = subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=cwd
    )
    try:
        yield process, Lines(process)
    finally:
        process.terminate()
        try:
            process.wait(10.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        assert process.stdout is not None
        process.stdout.close()


@contextmanager
def controller(port: int, arguments: Sequence[str]) -> Iterator[tuple[str, Lines]]:
    """``ltv-mpc controller ARGUMENTS`` behind a router at ``port``: the endpoint, and what the controller says."""
    endpoint = f"tcp/127.0.0.1:{port}"
    with (
        started(*CLI, "router", "--listen", endpoint) as (_, router),
        started(*CLI, "controller", "--connect", endpoint, *arguments) as (_, said),
    ):
        router.until(lambda line: "ready at" in line)
        said.until(lambda line: "waiting for" in line)
        yield endpoint, said
