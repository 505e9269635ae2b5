"""Watch: the terminal screen of any run or vehicle on a bus, read-only."""

from __future__ import annotations

import time

from ltv_mpc.messages import NodeStatus
from ltv_mpc.vehicle.parameters import Vehicle
from services.bus.options import BusOptions
from services.bus.session import open_session
from services.reporting.terminal import screen_for
from services.runtime.console import Console
from services.runtime.serve import run_until_stopped
from services.runtime.stopping import Say, StopRequest
from services.supervisor.bus_monitor import BusMonitor
from services.supervisor.live_view import live_view

UPDATE_S = 0.1
SILENT_S = 3.0
"""Wall time without a message of a process after which it counts as silent; a status comes once a second."""


def state_of(monitor: BusMonitor, node: str, now_s: float) -> str:
    """Return what is known of a process: finished, for how long it has been silent (s), or running."""
    status, activity = monitor.newest(NodeStatus, node), monitor.last_activity(node)
    if status is not None and status.finished:
        return "finished"
    silent_s = 0.0 if activity is None else now_s - activity.arrived_s
    return f"silent for {silent_s:.0f} s" if silent_s > SILENT_S else "running"


def main(bus: BusOptions, vehicle: str | None) -> int:
    """Show the screen until a signal stops it; with ``vehicle`` also bars of its thrusts. Return the exit code."""
    limits = [] if vehicle is None else [(one.min_N, one.max_N) for one in Vehicle.load(vehicle).thrusters]
    title = bus.namespace or ", ".join(bus.connects_to)

    def work(request: StopRequest, say: Say) -> None:
        with open_session(bus, stop=request, say=say) as session:
            monitor = BusMonitor(session, ["*"])
            started_s = time.monotonic()
            screen = screen_for(title, limits)
            try:
                while not request.wait(UPDATE_S):
                    now_s = time.monotonic()
                    states = {node: state_of(monitor, node, now_s) for node in monitor.nodes()}
                    screen.update(live_view(monitor, states, now_s - started_s))
            finally:
                screen.close()

    return run_until_stopped(Console("watch"), work)
