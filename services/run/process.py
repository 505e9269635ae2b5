"""One node as one process: signals, words to stderr, an exit code that is true."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from services.bus.session import BusError, BusOptions, Stopped
from services.run.clock import ClockError
from services.run.runner import Runner
from services.run.status import Say

DONE, FAILED, INTERRUPTED = 0, 1, 130


class StopRequest:
    """Set by SIGTERM and SIGINT; wakes whoever waits."""

    def __init__(self) -> None:
        self.event = threading.Event()
        self.wake: Callable[[], None] = lambda: None
        self.interrupted = False

    @property
    def exit_code(self) -> int:
        """Of a process that did stop cleanly."""
        return INTERRUPTED if self.interrupted else DONE

    def receive(self, number: int, _frame: FrameType | None) -> None:
        """The signal handler."""
        self.interrupted = number == signal.SIGINT
        self.event.set()
        self.wake()


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


def sayer(name: str) -> Say:
    """A process's words for a person: lines on stderr, with its name."""

    def say(text: str) -> None:
        sys.stderr.write(f"{name}: {text}\n")
        sys.stderr.flush()

    return say


def serve(name: str, bus: BusOptions, make: Callable[[StopRequest, Say], Runner]) -> int:
    """Run until told to stop or done. The exit code: 0 done, 1 failed with a line that says why, 130 Ctrl-C."""
    say = sayer(name)
    with stop_on_signals() as request:
        try:
            runner = make(request, say)
            request.wake = runner.mailbox.wake
            runner.serve(bus)
        except Stopped:
            pass
        except (BusError, ClockError) as error:
            say(str(error))
            return FAILED
        return request.exit_code
