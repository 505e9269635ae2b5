"""One node as one process."""

from __future__ import annotations

from collections.abc import Callable

from services.bus.session import BusError, BusOptions, Stopped
from services.process.clock import ClockError
from services.process.runner import Runner
from services.process.stopping import FAILED, Say, StopRequest, sayer, stop_on_signals
from services.process.supervised import SUPERVISED


def serve(name: str, bus: BusOptions, make: Callable[[StopRequest, Say], Runner]) -> int:
    """Run until told to stop or done. The exit code: 0 done, 1 failed with a line that says why, 130 Ctrl-C."""
    say = sayer(name)
    with stop_on_signals() as request:
        try:
            state = SUPERVISED.state()
            make(request, say).serve(bus, state)
        except Stopped:
            pass
        except (BusError, ClockError) as error:
            say(str(error))
            return FAILED
        return request.exit_code
