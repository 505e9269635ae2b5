"""Watch: the terminal screen of any run or vehicle on a bus, read-only."""

from __future__ import annotations

import dataclasses
import time

from ltv_mpc.messages import NodeStatus
from ltv_mpc.vehicle.parameters import Vehicle
from services.bus.mailbox import Mailbox
from services.bus.options import BusOptions
from services.bus.roles import ROUTER
from services.bus.session import open_session
from services.bus.topics import BY_TYPE
from services.reporting.terminal import RunScreen
from services.runtime.console import Console
from services.runtime.serve import run_until_stopped
from services.runtime.stopping import Say, StopRequest
from services.supervisor.bus_monitor import BusMonitor

UPDATE_S = 0.1
STATUS = BY_TYPE[NodeStatus].key
SILENT_S = 3.0
"""Wall time without a message of a process after which it counts as silent; a status comes once a second."""


def state_of(monitor: BusMonitor, node: str, now_s: float) -> str:
    """Return what is known of a process: finished, for how long it has been silent (s), or running."""
    status, activity = monitor.newest(NodeStatus, node), monitor.last_activity(node)
    if status is not None and status.finished:
        return "finished"
    silent_s = 0.0 if activity is None else now_s - activity.arrived_s
    return f"silent for {silent_s:.0f} s" if silent_s > SILENT_S else "running"


def silence(monitor: BusMonitor, now_s: float) -> str:
    """Return that no message has arrived yet, or for how long none has (s); empty while messages arrive."""
    activity = monitor.last_activity(ROUTER)
    if activity is None or activity.arrived_s == 0.0:
        return "no message yet"
    silent_s = now_s - activity.arrived_s
    return f"no message for {silent_s:.0f} s" if silent_s > SILENT_S else ""


def main(bus: BusOptions, vehicle: str | None) -> int:
    """Show the screen until a signal stops it; with ``vehicle`` also bars of its thrusts. Return the exit code."""
    known = None if vehicle is None else Vehicle.load(vehicle)
    title = bus.namespace or ", ".join(bus.connects_to)

    def work(request: StopRequest, say: Say) -> None:
        with open_session(bus, stop=request, say=say) as session:
            monitor, others, named = BusMonitor(session, ["*"]), Mailbox(), {""}
            if not bus.namespace:
                session.subscribe(f"**/{STATUS}/*", BY_TYPE[NodeStatus], others)
            started_s = time.monotonic()
            screen = RunScreen(title, known)
            try:
                while not request.wait(UPDATE_S):
                    now_s = time.monotonic()
                    states = {node: state_of(monitor, node, now_s) for node in monitor.nodes()}
                    view = monitor.view(states, now_s - started_s)
                    screen.update(dataclasses.replace(view, phase=silence(monitor, now_s) or view.phase))
                    while (status := others.take(0.0)) is not None:
                        namespace = status.key.rpartition(f"/{STATUS}/")[0]
                        if not states and namespace not in named:
                            screen.say(f"processes publish in another namespace: add --namespace {namespace}")
                            named.add(namespace)
            finally:
                screen.close()

    return run_until_stopped(Console("watch"), work)
