"""Process group of a run: all its processes, the restarts of those that fail, and their stop in order.

dead      it has an exit code: its pidfd becomes readable, and ``select`` returns within milliseconds
hung      no heartbeat for the hang timeout: it is killed                 (``managed_process.py``)
restart   with the newest state it had published                          (``BusMonitor.restore_state``)
back      its first message of work under a new epoch                     (``BusMonitor.last_activity``)

A process is restarted if the process table allows it, all processes had been ready before, and fewer than
``MAX_RESTARTS`` restarts of any process were done within the last ``WINDOW_S`` (as systemd's StartLimitBurst). Another
restart does not repair a process that fails again and again; the run then ends in order, with the reason.
"""

from __future__ import annotations

import select
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import msgspec

from ltv_mpc.messages import NodeStatus, RunEvent
from services.bus.outbox import Outbox
from services.bus.roles import SUPERVISOR
from services.recording.writer import ENDED
from services.runtime.stopping import DONE
from services.supervisor.bus_monitor import Activity, BusMonitor
from services.supervisor.child import describe_exit, last_lines
from services.supervisor.entry_point import write_config
from services.supervisor.forkserver import ForkServer
from services.supervisor.managed_process import ManagedProcess
from services.supervisor.parent_death import OrphanCleanup
from services.supervisor.process_table import ProcessRow
from services.supervisor.screen import Screen

MAX_RESTARTS = 5
WINDOW_S = 60.0

RECOVERY_TIMEOUT_S = 60.0
"""Longest time from a restart to the first message; after it the process has failed again."""

RECORDING_PROCESSES = frozenset({"router", "recorder"})
"""Processes without which no event is recorded."""

RECONNECT_S = 1.0
"""Time after the router's return in which all processes have found it again."""

ORDERLY_S = 2.0  # for one node, after a complete run
ORDERLY_RECORDER_S = 10.0  # a slow disk
HASTY_S = 0.7  # for all nodes together, after Ctrl-C or a failure; with the two below, at most 2 s for the whole stop
HASTY_RECORDER_S = 0.9
HASTY_ROUTER_S = 0.2


class Failure(NamedTuple):
    """Death or hang of one process, until a new process in its place has shown that it works."""

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


class ProcessGroup:
    """Processes of one run. Its events are shown at once, and published as soon as they can be recorded.

    Until ``connect`` every failure ends the run. Use it in the main thread: the kernel kills a child when the thread
    that adopted it ends.
    """

    def __init__(self, scenario: Path, logs: Path, screen: Screen) -> None:
        self.by_name: dict[str, ManagedProcess] = {}
        """Newest process of each row, in the order of the first starts."""
        self.cleanup = OrphanCleanup()
        self.forks = ForkServer(scenario, logs / "forkserver.log", self.cleanup.group)
        self.restarts_s: list[float] = []
        """Monotonic times of the restarts of any process."""
        self.all_ready = False
        """Set once every process has been ready."""
        self.recovering: dict[str, Failure] = {}
        """Failures of the restarted processes that do not work again yet."""
        self.pending: list[RunEvent] = []
        """Events that are not published yet."""
        self._publish_from_s = 0.0
        self._logs, self._screen = logs, screen
        self._monitor: BusMonitor
        self._outbox: Outbox

    def connect(self, monitor: BusMonitor, outbox: Outbox) -> None:
        """Use the run's bus, for the states of failed processes and to report events."""
        self._monitor, self._outbox = monitor, outbox

    def start(self, row: ProcessRow, config: msgspec.Struct) -> None:
        """Write the config of a process and start it."""
        write_config(self._config(row), config)
        self._start(row, 1)

    @property
    def run_complete(self) -> bool:
        """True once the plant has done its last step."""
        plant = self.by_name.get("plant")
        return plant is not None and plant.exit_code() == DONE

    def states(self) -> dict[str, str]:
        """Return the state of each process, for the screen."""
        states = {}
        for name, process in self.by_name.items():
            if (code := process.exit_code()) is not None:
                states[name] = "ended" if code == DONE else "failed"
            elif name in self.recovering:
                states[name] = "restarting"
            elif name == "router" or self._monitor.newest(NodeStatus, name) is not None:
                states[name] = "running" if self._monitor.running() else "ready"
            else:
                states[name] = "spawned"
        return states

    def wait(self, timeout_s: float, stop: Callable[[], bool]) -> None:
        """Read heartbeats for ``timeout_s``. Return earlier if a process has ended or a stop is requested."""
        until = time.monotonic() + timeout_s
        running = [process for process in self.by_name.values() if process.exit_code() is None]
        while (left_s := until - time.monotonic()) > 0 and not stop():
            select.select([fd for process in running for fd in (process.lifeline, process.pidfd)], [], [], left_s)
            for process in running:
                process.read_heartbeats()
            if any(process.exit_code() is not None for process in running):
                return

    def stop(self, *, in_order: bool, close_session: Callable[[], None]) -> list[str]:
        """Stop all processes: nodes, then the recorder, which records their last messages, then the router.

        ``in_order``: stop one node after the other, so that each receives all messages of the one before; otherwise all
        at once. ``close_session`` closes the supervisor's own session, before the router stops. Return the names of
        those that had to be killed because they had not exited in time.
        """
        self.forks.close()
        nodes = [process for name, process in self.by_name.items() if name not in RECORDING_PROCESSES]
        if not in_order:
            for process in nodes:
                process.terminate()
        killed, until = [], time.monotonic() + HASTY_S

        def stop(process: ManagedProcess | None, timeout_s: float) -> None:
            if process is not None:
                process.terminate()
                if not process.wait(timeout_s):
                    process.kill()
                    killed.append(process.row.name)
                process.close()

        for process in nodes:
            stop(process, ORDERLY_S if in_order else until - time.monotonic())
        stop(self.by_name.get("recorder"), ORDERLY_RECORDER_S if in_order else HASTY_RECORDER_S)
        close_session()
        stop(self.by_name.get("router"), ORDERLY_S if in_order else HASTY_ROUTER_S)
        self.cleanup.close()
        return killed

    def check(self, now_s: float) -> None:
        """Find failed processes and restart them.

        Raises ``RunFailed`` if a process may not be restarted.
        """
        for name, process in tuple(self.by_name.items()):
            alive_s = process.hang_detector.last_s or now_s
            if self.run_complete:
                return
            if (code := process.exit_code()) is not None:
                self._restart(name, describe_exit(code), alive_s, now_s)
            elif process.hang_detector.hung(now_s):
                self._restart(name, f"hung: no heartbeat for {now_s - alive_s:.2f} s", alive_s, now_s)

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
                self._restart(name, f"did not recover within {RECOVERY_TIMEOUT_S:.0f} s", failure.alive_s, now_s)
        if now_s >= self._publish_from_s and not self.recovering.keys() & RECORDING_PROCESSES:
            self._publish()

    def may_restart(self, now_s: float) -> bool:
        """Count one restart of any process. Return False if none is left."""
        if sum(now_s - then_s < WINDOW_S for then_s in self.restarts_s) >= MAX_RESTARTS:
            return False
        self.restarts_s.append(now_s)
        return True

    def show(self, event: RunEvent) -> None:
        """Print an event on the screen."""
        self._screen.say(f"{event.t_ns / 1e9:.1f} s  {event.node}: {event.text}")

    def end(self, why: str) -> None:
        """Publish at once why the run ends early; the screen shows it as the outcome of the run."""
        self.pending.append(self._event(ENDED, why))
        self._publish()

    def _config(self, row: ProcessRow) -> Path:
        return self._logs / f"{row.name}.json"

    def _start(self, row: ProcessRow, number: int, state: bytes = b"") -> None:
        """Start a process for the ``number``-th time. ``state`` is the one that it continues from, or empty."""
        config = self._config(row)
        log = config.with_suffix(".log" if number == 1 else f".{number}.log")
        pid, lifeline = self.forks.start(row.module, config, log, state)
        self.by_name[row.name] = ManagedProcess(pid, lifeline, row, log, number)

    def _restart(self, name: str, how: str, alive_s: float, now_s: float) -> None:
        """Kill a failed process, if it still runs, and start another one in its place."""
        process = self.by_name[name]
        process.kill()
        text, lines = f"{name} {how}", last_lines(process.log)
        if not process.row.restartable or not self.all_ready:
            raise RunFailed(text, lines)
        if not self.may_restart(now_s):
            limit = f"the limit of {MAX_RESTARTS} restarts within {WINDOW_S:.0f} s is reached: stopping safely"
            raise RunFailed(f"{text}; {limit}", lines, in_order=True)
        before, earlier = self._monitor.last_activity(name), self.recovering.get(name)
        process.close()
        self._start(process.row, process.number + 1, self._monitor.restore_state(name))
        self.recovering[name] = Failure(
            how,
            alive_s if earlier is None else earlier.alive_s,
            old_epoch=0 if before is None else before.epoch,
            restarted_s=time.monotonic(),
        )
        self._report("fault", f"{text}; detected {now_s - alive_s:.2f} s after its last heartbeat")

    def _report(self, kind: str, text: str) -> None:
        """Show an event, and queue it for publication."""
        self.pending.append(self._event(kind, text))
        self.show(self.pending[-1])

    def _event(self, kind: str, text: str) -> RunEvent:
        return RunEvent(t_ns=self._monitor.t_ns() or 0, node=SUPERVISOR, kind=kind, text=text)

    def _publish(self) -> None:
        for event in self.pending:
            self._outbox.publish(event)
        self.pending.clear()
