"""Main function of a process: signals, failures and exit code."""

from __future__ import annotations

from collections.abc import Callable

from services.bus.session import BusError, Stopped
from services.runtime.clock import ClockError
from services.runtime.console import Console
from services.runtime.stopping import FAILED, Say, StopRequest, stop_on_signals


def run_until_stopped(
    console: Console,
    work: Callable[[StopRequest, Say], None],
    *,
    failures: tuple[type[Exception], ...] = (BusError, ClockError),
    request: StopRequest | None = None,
) -> int:
    """Run ``work`` until it returns or a signal stops it. Return the exit code: 0 done, 1 failed, 130 Ctrl-C.

    Lines go to ``console``; an exception of ``failures`` becomes one of them, with exit code 1. The signals make
    ``request``; None: one of its own.
    """
    with stop_on_signals(request) as stop:
        try:
            work(stop, console.say)
        except Stopped:
            pass
        except failures as error:
            console.say(str(error))
            return FAILED
        return stop.exit_code
