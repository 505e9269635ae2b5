"""The state that a process continues from when it takes the place of a dead one.

It is the newest that the dead one has published, with what is newer by then: the estimate, and for a controller the
plan in force at the actuators. Nobody else publishes these while the process is dead.
"""

from __future__ import annotations

import msgspec

from ltv_mpc.messages import ControllerState, Estimate
from services.bus.topics import STATES
from services.bus.wire import Header, encode
from services.supervisor.bus_monitor import BusMonitor


def restore_state(node: str, watch: BusMonitor) -> bytes:
    """Return the state for a new process of this name, as it travels; empty where it has none to continue from."""
    kind = STATES.get(node)
    state = None if kind is None else watch.newest(kind)
    if state is None:
        return b""
    state = msgspec.structs.replace(state, estimate=watch.newest(Estimate) or state.estimate)
    if isinstance(state, ControllerState):
        state = msgspec.structs.replace(state, plan=watch.plan_in_force())
    return encode(state, Header(epoch=0, sequence=0))
