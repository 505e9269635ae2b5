"""How a process is told to stop, and what it says and returns: signals, words on stderr, true exit codes."""

from __future__ import annotations

import contextlib
import queue
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TypeAlias

DONE, FAILED, INTERRUPTED = 0, 1, 130

Say: TypeAlias = Callable[[str], None]
"""One line for a person."""


class StopRequest:
    """Asked for by a signal or another thread. No lock in it: a handler may come while the same thread waits here."""

    def __init__(self) -> None:
        self.requested = False
        self.interrupted = False
        self._bell: queue.SimpleQueue[None] = queue.SimpleQueue()
        self._wake: Callable[[], None] = lambda: None

    def __call__(self) -> bool:
        """Whether it was asked for."""
        return self.requested

    @property
    def exit_code(self) -> int:
        """Of a process that did stop cleanly."""
        return INTERRUPTED if self.interrupted else DONE

    def on_request(self, wake: Callable[[], None]) -> None:
        """``wake`` is called when it is asked for, to end a wait elsewhere."""
        self._wake = wake

    def request(self) -> None:
        """Ask for it."""
        self.requested = True
        self._bell.put(None)
        self._wake()

    def receive(self, number: int, _frame: FrameType | None) -> None:
        """Ask for it by signal."""
        self.interrupted = number == signal.SIGINT
        self.request()

    def wait(self, timeout_s: float | None = None) -> bool:
        """Wait until it is asked for, at most ``timeout_s``; whether it was."""
        if not self.requested:
            with contextlib.suppress(queue.Empty):
                self._bell.get(timeout=timeout_s)
        return self.requested


@contextmanager
def stop_on_signals() -> Iterator[StopRequest]:
    """SIGTERM and SIGINT ask for a clean stop while this lasts."""
    request = StopRequest()
    before = {number: signal.signal(number, request.receive) for number in (signal.SIGTERM, signal.SIGINT)}
    try:
        yield request
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def stderr_printer(name: str) -> Say:
    """A process's words for a person: lines on stderr, with its name."""

    def say(text: str) -> None:
        sys.stderr.write(f"{name}: {text}\n")
        sys.stderr.flush()

    return say
