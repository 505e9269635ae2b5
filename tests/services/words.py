"""Messages of processes about themselves and the clock, for tests of who hears them."""

from __future__ import annotations

from typing import Any

from ltv_mpc.messages import Clock, ClockState, NodeStatus
from services.runtime.clock import boot_id


def status(node: str, **what: Any) -> NodeStatus:
    """Of a process that is ready and has done nothing, but for ``what``."""
    return NodeStatus(**{"node": node, "t_ns": 0, "ready": True, "published": 0, **what})


def running_clock(at_us: int, *, epoch: int = 3, vehicle_ns: int = 0) -> Clock:
    """Of a clock that begins at the monotonic time ``at_us`` and runs in real time."""
    return Clock(
        clock_epoch=epoch,
        clock_sequence=0,
        host_boot_id=boot_id(),
        at_monotonic_us=at_us,
        vehicle_ns=vehicle_ns,
        speed_num=1,
        speed_den=1,
        requested_speed=1.0,
        state=ClockState.RUNNING,
    )
