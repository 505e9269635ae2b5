"""State that a restarted process continues from.

It is the newest state that the failed process has published, updated with newer messages: the newest estimate, and for
a controller the plan that the actuators follow. No other process publishes these while the process is dead.
"""

from __future__ import annotations

import msgspec

from ltv_mpc.messages import ControllerState, Estimate
from services.bus.topics import STATES
from services.bus.wire import Header, encode
from services.supervisor.bus_monitor import BusMonitor


def restore_state(node: str, monitor: BusMonitor) -> bytes:
    """Return the encoded state for a new process of this name; empty if there is none to continue from."""
    kind = STATES.get(node)
    state = None if kind is None else monitor.newest(kind)
    if state is None:
        return b""
    state = msgspec.structs.replace(state, estimate=monitor.newest(Estimate) or state.estimate)
    if isinstance(state, ControllerState):
        state = msgspec.structs.replace(state, plan=monitor.plan_in_force())
    return encode(state, Header(epoch=0, sequence=0))
