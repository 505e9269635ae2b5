"""The router process: passes messages between all others, and knows nothing of them."""

from __future__ import annotations

import msgspec

from services.bus.session import ROUTER_ENDPOINT, BusError, BusOptions, Stopped, open_session
from services.process.stopping import FAILED, sayer, stop_on_signals


def main(bus: BusOptions) -> int:
    """Route until told to stop; by default at the place where the others look."""
    say = sayer("router")
    endpoints = bus.listen or (ROUTER_ENDPOINT,)
    options = msgspec.structs.replace(bus, listen=endpoints, mode=bus.mode or "router", namespace="")
    with stop_on_signals() as request:
        try:
            with open_session(options, stop=request, say=say):
                say(f"ready at {', '.join(endpoints)}")
                request.wait()
        except Stopped:
            pass
        except BusError as error:
            say(str(error))
            return FAILED
        return request.exit_code
