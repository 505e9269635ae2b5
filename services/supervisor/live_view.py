"""Live view of a run or of a vehicle for the screen, from the newest messages on the bus."""

from __future__ import annotations

from collections.abc import Mapping

from ltv_mpc.messages import (
    Applied,
    Clock,
    ClockState,
    ControllerStatus,
    CycleTiming,
    Estimate,
    LocalisationReport,
    NodeStatus,
    Plan,
    Truth,
)
from ltv_mpc.node import DEFAULT_SOURCE
from services.supervisor.bus_monitor import BusMonitor
from services.supervisor.screen import LiveView


def live_view(
    monitor: BusMonitor, states: Mapping[str, str], wall_s: float, *, start_ns: int = 0, end_ns: int | None = None
) -> LiveView:
    """Return the view at this moment. ``states`` are the states of the processes, by name.

    ``start_ns`` and ``end_ns`` bound the vehicle time of a run; a vehicle has neither.
    """
    clock, controller = monitor.newest(Clock), monitor.newest(ControllerStatus)
    estimate = monitor.newest(Estimate, _key_part(controller))
    t_ns = monitor.t_ns()
    if t_ns is None:
        t_ns = start_ns if clock is not None or estimate is None else estimate.t_ns
    status = {name: newest for name in states if (newest := monitor.newest(NodeStatus, name)) is not None}
    return LiveView(
        t_ns=t_ns if end_ns is None else min(t_ns, end_ns),
        start_ns=start_ns,
        end_ns=end_ns,
        speed=1.0 if clock is None else clock.speed_num / clock.speed_den,
        requested_speed=1.0 if clock is None else clock.requested_speed,
        wall_s=wall_s,
        phase=_phase(clock, t_ns, end_ns),
        truth=monitor.newest(Truth),
        estimate=estimate,
        localisation=monitor.newest(LocalisationReport),
        plan=monitor.newest(Plan),
        applied=monitor.newest(Applied),
        controller=controller,
        timing=monitor.newest(CycleTiming),
        status=status,
        state=states,
    )


def _key_part(controller: ControllerStatus | None) -> str:
    """Return the last part of the key of the estimates that the controller uses; empty for the plain key."""
    return "" if controller is None or controller.source == DEFAULT_SOURCE else controller.source


def _phase(clock: Clock | None, t_ns: int, end_ns: int | None) -> str:
    if clock is None:
        return "" if end_ns is None else "starting"
    if clock.state is ClockState.WAITING:
        return "starting"
    if clock.state is ClockState.PAUSED:
        return "stopping" if end_ns is not None and t_ns >= end_ns else "paused"
    return "afloat" if t_ns < 0 else "diving"
