"""Router and controller as separate processes, started as a user starts them."""

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
    """Output of a process, line by line."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process
        self._lines: SimpleQueue[str] = SimpleQueue()
        self.said: list[str] = []
        self.reader = threading.Thread(target=self._read, daemon=True)
        self.reader.start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self._lines.put(line)

    def until(self, wanted: Callable[[str], bool], within_s: float = PATIENCE_S) -> str:
        """Return the first unread line for which ``wanted`` is true."""
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
    """Start a process with its output (both streams) and end it with the block."""
    process = subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=cwd
    )
    lines = Lines(process)
    try:
        yield process, lines
    finally:
        process.terminate()
        try:
            process.wait(10.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        lines.reader.join(10.0)  # it has read to the end, unless a child of the process holds the pipe open
        assert process.stdout is not None
        process.stdout.close()


@contextmanager
def controller(port: int, arguments: Sequence[str]) -> Iterator[tuple[str, Lines]]:
    """Start ``ltv-mpc controller ARGUMENTS`` and a router at ``port``; yield endpoint and output of the controller."""
    endpoint = f"tcp/127.0.0.1:{port}"
    with (
        started(*CLI, "router", "--listen", endpoint) as (_, router),
        started(*CLI, "controller", "--connect", endpoint, *arguments) as (_, said),
    ):
        router.until(lambda line: "ready at" in line)
        said.until(lambda line: "waiting for" in line)
        yield endpoint, said


def arm(cli: Sequence[str], endpoint: str, within_s: float = PATIENCE_S) -> str:
    """Send ``ctl arm`` until the controller accepts it, and return what it printed.

    The controller rejects the command before its first estimate.
    """
    deadline = time.monotonic() + within_s
    while True:
        command = [*cli, "ctl", "arm", "--connect", endpoint]
        sent = subprocess.run(command, capture_output=True, text=True, check=False)
        if sent.returncode == 0:
            return sent.stdout + sent.stderr
        assert time.monotonic() < deadline, sent.stderr
        assert "no estimate received yet" in sent.stderr or "no reply" in sent.stderr, sent.stderr
