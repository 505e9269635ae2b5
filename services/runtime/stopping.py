"""Stop requests, lines on stderr and exit codes of a process."""

from __future__ import annotations

import contextlib
import queue
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any, TextIO, TypeAlias

from services.runtime.console import PrintedStream, drawn

DONE, FAILED, INTERRUPTED = 0, 1, 130

Say: TypeAlias = Callable[[str], None]
"""Function that prints one line for the user."""


class StopRequest:
    """Request to stop, made by a signal or another thread.

    It uses no lock: a signal handler may run in the thread that waits here.
    """

    def __init__(self) -> None:
        self.requested = False
        self.interrupted = False
        self.signals = 0
        """Number of signals, hang-ups left out: a terminal that closes causes two, the second by the next text."""
        self._wakeups: queue.SimpleQueue[None] = queue.SimpleQueue()
        self._wake: Callable[[], None] = lambda: None

    def __call__(self) -> bool:
        """Return True if a stop is requested."""
        return self.requested

    @property
    def exit_code(self) -> int:
        """Exit code of a process that has stopped cleanly: 130 after Ctrl-C, else 0."""
        return INTERRUPTED if self.interrupted else DONE

    def on_request(self, wake: Callable[[], None]) -> None:
        """Call ``wake`` at the request, to end a wait elsewhere."""
        self._wake = wake

    def request(self) -> None:
        """Request a stop."""
        self.requested = True
        self._wakeups.put(None)
        self._wake()

    def receive(self, number: int, _frame: FrameType | None) -> None:
        """Request a stop, as a signal handler."""
        self.interrupted = number == signal.SIGINT
        self.signals += number != signal.SIGHUP
        self.request()

    def wait(self, timeout_s: float | None = None) -> bool:
        """Wait for a request, at most ``timeout_s``. Return True if there is one."""
        if not self.requested:
            with contextlib.suppress(queue.Empty):
                self._wakeups.get(timeout=timeout_s)
        return self.requested


@contextmanager
def stop_on_signals(request: StopRequest | None = None) -> Iterator[StopRequest]:
    """Make SIGTERM, SIGINT and SIGHUP request a clean stop within the context; ``nohup`` ignores SIGHUP."""
    request = request or StopRequest()
    numbers = [signal.SIGTERM, signal.SIGINT]
    if signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:
        numbers.append(signal.SIGHUP)
    before = {number: signal.signal(number, request.receive) for number in numbers}
    try:
        yield request
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class HangUpStream:
    """Standard error whose reader may end, as a pipe or a terminal that is closed.

    The first failure to write counts as the hang-up of a terminal: SIGHUP, if this process handles it. Later text is
    discarded.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._closed = False

    def write(self, text: str) -> int:
        """Write a text; return its length."""
        self._try(self._stream.write, text)
        return len(text)

    def flush(self) -> None:
        """Pass the text on to the reader."""
        self._try(self._stream.flush)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def _try(self, act: Callable[..., object], *arguments: str) -> None:
        try:
            if not self._closed:
                act(*arguments)
        except OSError:
            self._closed = True
            if callable(signal.getsignal(signal.SIGHUP)):
                signal.raise_signal(signal.SIGHUP)


@contextmanager
def hang_up_with_stderr() -> Iterator[None]:
    """Make the end of standard error's reader a SIGHUP within the context."""
    stderr = sys.stderr
    sys.stderr = PrintedStream(HangUpStream(drawn(stderr)))  # type: ignore[arg-type]
    try:
        yield
    finally:
        sys.stderr = stderr
