"""Failure handling: finds dead and hung processes, restarts them, and watches until each works again.

dead      its heartbeat pipe is closed and it has an exit code            (``managed_process.py``)
hung      no heartbeat for the hang timeout: it is killed                 (``hang_detector.py``)
restart   if the policy allows it, with the newest state it had published  (``restarts.py``, ``restore_state``)
back      its first message of work under a new epoch                     (``BusMonitor.last_activity``)
"""

from __future__ import annotations

import time
from collections.abc import Collection

import msgspec

from ltv_mpc.messages import ControllerState, Estimate
from services.bus.topics import STATES
from services.bus.wire import Header, encode
from services.runtime.stopping import DONE
from services.supervisor.bus_monitor import BusMonitor
from services.supervisor.child_processes import ChildProcesses
from services.supervisor.managed_process import ManagedProcess, describe_exit
from services.supervisor.restarts import ProcessFailure, Recovery, RestartBudget, restart_refusal
from services.supervisor.run_events import RECORDING_PROCESSES, RunEvents

RECOVERY_TIMEOUT_S = 60.0
"""Longest time from a restart to the first message; after it the process has failed again."""


class RunFailed(Exception):
    """End of a run by a failure, with the last log lines of the process that failed."""

    def __init__(self, why: str, last_lines: tuple[str, ...] = (), *, in_order: bool = False) -> None:
        self.why = why
        self.last_lines = last_lines
        self.in_order = in_order


class FailureHandler:
    """Restarts of one run. Until ``connect`` every failure ends the run."""

    def __init__(self, children: ChildProcesses) -> None:
        self.restarts = 0
        self.all_ready = False
        """Set once every process has been ready."""
        self._children = children
        self._budget = RestartBudget()
        self._recoveries: dict[str, Recovery] = {}
        self._monitor: BusMonitor | None = None
        self._events: RunEvents | None = None

    def connect(self, monitor: BusMonitor, events: RunEvents) -> None:
        """Use the run's bus, for the states of failed processes and to report events."""
        self._monitor, self._events = monitor, events

    @property
    def recovering(self) -> Collection[str]:
        """Names of the restarted processes that do not work again yet."""
        return self._recoveries.keys()

    def failure_of(self, name: str) -> ProcessFailure | None:
        """Return the failure that a process has not recovered from yet."""
        recovery = self._recoveries.get(name)
        return None if recovery is None else recovery.failure

    def check(self, now_s: float) -> None:
        """Find failed processes and restart them.

        Raises ``RunFailed`` if a process may not be restarted.
        """
        for name, child in tuple(self._children.by_name.items()):
            failure = self._find_failure(name, child, now_s)
            if failure is not None:
                self._restart(failure)

    def check_recoveries(self, now_s: float) -> None:
        """End the recoveries of processes that work again; restart those that do not come back in time."""
        assert self._monitor is not None
        assert self._events is not None
        for name, recovery in tuple(self._recoveries.items()):
            activity, failure = self._monitor.last_activity(name), recovery.failure
            if activity is not None and recovery.is_over(activity.epoch, activity.arrived_s):
                del self._recoveries[name]
                self._events.on_recovery(name, now_s)
                took_s = activity.arrived_s - failure.alive_s
                self._events.report(
                    "restart", f"{name} {failure.how}; recovered {took_s:.2f} s after its last heartbeat"
                )
            elif now_s - recovery.started_s > RECOVERY_TIMEOUT_S:
                self._children.by_name[name].kill()
                how = f"did not recover within {RECOVERY_TIMEOUT_S:.0f} s"
                self._restart(ProcessFailure(name, how, failure.alive_s, now_s))
        if not self._recoveries.keys() & RECORDING_PROCESSES:
            self._events.publish_pending(now_s)

    def _find_failure(self, name: str, child: ManagedProcess, now_s: float) -> ProcessFailure | None:
        """Return the failure of a process that is dead, or that hangs and is killed here."""
        alive_s = child.hang_detector.last_s or now_s
        code = child.exit_code()
        if code is None:
            if self._children.run_complete or not child.hang_detector.hung(now_s):
                return None
            child.kill()
            return ProcessFailure(name, f"hung: no heartbeat for {now_s - alive_s:.2f} s", alive_s, now_s)
        if (name == "plant" and code == DONE) or self._children.run_complete:
            return None
        return ProcessFailure(name, describe_exit(code), alive_s, now_s)

    def _restart(self, failure: ProcessFailure) -> None:
        name = failure.node
        refusal = restart_refusal(
            failure,
            restartable=self._children.restartable(name),
            had_started=self.all_ready,
            budget=self._budget,
        )
        if refusal is not None:
            lines = self._children.by_name[name].last_lines()
            raise RunFailed(f"{refusal.why}; its last lines:", lines, in_order=refusal.in_order)
        assert self._monitor is not None
        assert self._events is not None
        before = self._monitor.last_activity(name)
        self._children.restart(name, restore_state(name, self._monitor))
        self.restarts += 1
        earlier = self.failure_of(name)
        alive_s = failure.alive_s if earlier is None else earlier.alive_s
        self._recoveries[name] = Recovery(
            failure._replace(alive_s=alive_s),
            old_epoch=0 if before is None else before.epoch,
            started_s=time.monotonic(),
        )
        silent_s = failure.seen_s - failure.alive_s
        self._events.report("fault", f"{name} {failure.how}; detected {silent_s:.2f} s after its last heartbeat")


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
