"""Live view of a run for the screen, from the newest messages on the bus."""

from __future__ import annotations

from collections.abc import Mapping

from ltv_mpc.messages import Applied, Clock, ClockState, CycleTiming, Estimate, NodeStatus, Plan, Truth
from services.run.run_config import RunConfig
from services.supervisor.bus_monitor import BusMonitor
from services.supervisor.screen import LiveView


def live_view(run_config: RunConfig, monitor: BusMonitor, states: Mapping[str, str], wall_s: float) -> LiveView:
    """Return the run at this moment. ``states`` are the states of the processes, by name."""
    scenario = run_config.scenario
    clock = monitor.newest(Clock)
    t_ns = monitor.t_ns()
    status = {name: newest for name in states if (newest := monitor.newest(NodeStatus, name)) is not None}
    return LiveView(
        t_ns=scenario.start_ns if t_ns is None else min(t_ns, scenario.end_ns),
        start_ns=scenario.start_ns,
        end_ns=scenario.end_ns,
        speed=scenario.run.speed if clock is None else clock.speed_num / clock.speed_den,
        requested_speed=scenario.run.speed if clock is None else clock.requested_speed,
        wall_s=wall_s,
        phase=_phase(clock, t_ns, scenario.end_ns),
        truth=monitor.newest(Truth),
        estimate=monitor.newest(Estimate),
        plan=monitor.newest(Plan),
        applied=monitor.newest(Applied),
        timing=monitor.newest(CycleTiming),
        status=status,
        state=states,
    )


def _phase(clock: Clock | None, t_ns: int | None, end_ns: int) -> str:
    if clock is None or t_ns is None or clock.state is ClockState.WAITING:
        return "starting"
    if clock.state is ClockState.PAUSED:
        return "stopping" if t_ns >= end_ns else "paused"
    return "afloat" if t_ns < 0 else "diving"
