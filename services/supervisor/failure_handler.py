"""Failure handling: finds dead and hung processes, restarts them, and watches until each works again.

dead      it has an exit code                                             (``managed_process.py``)
hung      no heartbeat for the hang timeout: it is killed                 (``managed_process.py``)
restart   with the newest state it had published                          (``restore_state``)
back      its first message of work under a new epoch                     (``BusMonitor.last_activity``)

A process is restarted if the process table allows it, all processes had been ready before, and fewer than
``MAX_RESTARTS`` restarts of any process were done within the last ``WINDOW_S`` (as systemd's StartLimitBurst). Another
restart does not repair a process that fails again and again; the run then ends in order, with the reason.
"""

from __future__ import annotations

import time
from collections import deque
from typing import NamedTuple

import msgspec

from ltv_mpc.messages import ControllerState, Estimate, RunEvent
from services.bus.outbox import Outbox
from services.bus.roles import SUPERVISOR
from services.bus.topics import STATES
from services.bus.wire import Header, encode
from services.recording.writer import ENDED
from services.supervisor.bus_monitor import Activity, BusMonitor
from services.supervisor.child_processes import ChildProcesses
from services.supervisor.managed_process import ManagedProcess, describe_exit
from services.supervisor.screen import Screen

MAX_RESTARTS = 5
WINDOW_S = 60.0

RECOVERY_TIMEOUT_S = 60.0
"""Longest time from a restart to the first message; after it the process has failed again."""


RECORDING_PROCESSES = frozenset({"router", "recorder"})
"""Processes without which no event is recorded."""

RECONNECT_S = 1.0
"""Time after the router's return in which all processes have found it again."""


class Failure(NamedTuple):
    """Death or hang of one process, until a new process in its place has shown that it works."""

    node: str
    how: str  # "was ended by SIGKILL", "hung: ..."
    alive_s: float  # last sign of life: the newest heartbeat
    old_epoch: int = 0  # epoch of the process that failed; 0 if it has none
    restarted_s: float = 0.0

    def is_over(self, activity: Activity) -> bool:
        """Return True if ``activity`` shows that the new process works."""
        return activity.arrived_s > self.restarted_s and (activity.epoch != self.old_epoch or self.old_epoch == 0)


class RunFailed(Exception):
    """End of a run by a failure, with the last log lines of the process that failed.

    ``in_order``: the other processes are well and may finish one after the other.
    """

    def __init__(self, why: str, last_lines: tuple[str, ...] = (), *, in_order: bool = False) -> None:
        self.why = why
        self.last_lines = last_lines
        self.in_order = in_order


class FailureHandler:
    """Restarts of one run, with their events: shown at once, published as soon as they can be recorded.

    Until ``connect`` every failure ends the run.
    """

    def __init__(self, children: ChildProcesses, screen: Screen) -> None:
        self.restarts = 0
        self.all_ready = False
        """Set once every process has been ready."""
        self._children = children
        self._restarts_s: deque[float] = deque(maxlen=MAX_RESTARTS)  # monotonic times
        self.recovering: dict[str, Failure] = {}
        """Failures of the restarted processes that do not work again yet."""
        self._screen = screen
        self.pending: list[RunEvent] = []
        """Events that are not published yet."""
        self._publish_from_s = 0.0
        self._monitor: BusMonitor
        self._outbox: Outbox

    def connect(self, monitor: BusMonitor, outbox: Outbox) -> None:
        """Use the run's bus, for the states of failed processes and to report events."""
        self._monitor, self._outbox = monitor, outbox

    def end(self, why: str) -> None:
        """Publish at once why the run ends early; the screen shows it as the outcome of the run."""
        self.pending.append(RunEvent(t_ns=self._monitor.t_ns() or 0, node=SUPERVISOR, kind=ENDED, text=why))
        self._publish()

    def show(self, event: RunEvent) -> None:
        """Print an event on the screen."""
        self._screen.say(f"{event.t_ns / 1e9:.1f} s  {event.node}: {event.text}")

    def check(self, now_s: float) -> None:
        """Find failed processes and restart them.

        Raises ``RunFailed`` if a process may not be restarted.
        """
        for name, child in tuple(self._children.by_name.items()):
            if how := self._how_failed(child, now_s):
                self._restart(name, how, child.hang_detector.last_s or now_s, now_s)

    def check_recoveries(self, now_s: float) -> None:
        """End the recoveries of processes that work again; restart those that do not come back in time."""
        for name, failure in tuple(self.recovering.items()):
            activity = self._monitor.last_activity(name)
            if activity is not None and failure.is_over(activity):
                del self.recovering[name]
                if name in RECORDING_PROCESSES:
                    self._publish_from_s = now_s + RECONNECT_S
                took_s = activity.arrived_s - failure.alive_s
                self._report("restart", f"{name} {failure.how}; recovered {took_s:.2f} s after its last heartbeat")
            elif now_s - failure.restarted_s > RECOVERY_TIMEOUT_S:
                self._children.by_name[name].kill()
                self._restart(name, f"did not recover within {RECOVERY_TIMEOUT_S:.0f} s", failure.alive_s, now_s)
        if now_s >= self._publish_from_s and not self.recovering.keys() & RECORDING_PROCESSES:
            self._publish()

    def may_restart(self, now_s: float) -> bool:
        """Count one restart of any process. Return False if none is left."""
        if len(self._restarts_s) == MAX_RESTARTS and now_s - self._restarts_s[0] < WINDOW_S:
            return False
        self._restarts_s.append(now_s)
        return True

    def _how_failed(self, child: ManagedProcess, now_s: float) -> str:
        """Say how a process is dead, or hangs and is killed here; empty if it is well."""
        code = child.exit_code()
        if self._children.run_complete:
            return ""
        if code is not None:
            return describe_exit(code)
        if not child.hang_detector.hung(now_s):
            return ""
        child.kill()
        return f"hung: no heartbeat for {now_s - (child.hang_detector.last_s or now_s):.2f} s"

    def _restart(self, name: str, how: str, alive_s: float, now_s: float) -> None:
        child = self._children.by_name[name]
        text, lines = f"{name} {how}", child.last_lines()
        if not child.row.restartable or not self.all_ready:
            raise RunFailed(text, lines)
        if not self.may_restart(now_s):
            limit = f"the limit of {MAX_RESTARTS} restarts within {WINDOW_S:.0f} s is reached: stopping safely"
            raise RunFailed(f"{text}; {limit}", lines, in_order=True)
        before = self._monitor.last_activity(name)
        child.start(restore_state(name, self._monitor))
        self.restarts += 1
        earlier = self.recovering.get(name)
        self.recovering[name] = Failure(
            name,
            how,
            alive_s if earlier is None else earlier.alive_s,
            old_epoch=0 if before is None else before.epoch,
            restarted_s=time.monotonic(),
        )
        self._report("fault", f"{text}; detected {now_s - alive_s:.2f} s after its last heartbeat")

    def _report(self, kind: str, text: str) -> None:
        """Show an event, and queue it for publication."""
        event = RunEvent(t_ns=self._monitor.t_ns() or 0, node=SUPERVISOR, kind=kind, text=text)
        self.show(event)
        self.pending.append(event)

    def _publish(self) -> None:
        for event in self.pending:
            self._outbox.publish(event)
        self.pending.clear()


def restore_state(node: str, monitor: BusMonitor) -> bytes:
    """Return the encoded state that a new process of this name continues from; empty if there is none.

    It is the newest state that the failed process has published, updated with newer messages: the newest estimate, and
    for a controller the plan that the actuators follow. No other process publishes these while the process is dead.
    """
    kind = STATES.get(node)
    state = None if kind is None else monitor.newest(kind)
    if state is None:
        return b""
    state = msgspec.structs.replace(state, estimate=monitor.newest(Estimate) or state.estimate)
    if isinstance(state, ControllerState):
        state = msgspec.structs.replace(state, plan=monitor.plan_in_force())
    return encode(state, Header(epoch=0, sequence=0))
