"""The launcher: starts every process of a run, watches, mends, stops them in order, and says truthfully how it went.

Plant, sensors and the rest run until the plant has done its last step. Who dies before or hangs is named: estimator,
controller, recorder and router are started anew (``restarts.py``), all others are the world, whose end is the run's.
Ctrl-C ends everything within two seconds. The recorder is stopped last, so that it hears the last word of all others.
"""

from __future__ import annotations

import importlib
import secrets
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeAlias

from ltv_mpc.messages import NodeStatus, RunEvent
from services.bus.options import SECURE, BusOptions
from services.bus.outbox import Outbox, new_epoch
from services.bus.roles import LAUNCHER
from services.bus.session import Session, Stopped, open_session
from services.recording import join
from services.run.folder import RunFolder
from services.run.run_config import RunConfig
from services.run.summary import summarise_recording
from services.runtime.stopping import DONE, FAILED, INTERRUPTED, StopRequest, stop_on_signals
from services.supervisor import jit_cache, loopback, process_table, shutdown
from services.supervisor.bus_monitor import BusMonitor
from services.supervisor.child_processes import ChildProcesses
from services.supervisor.hang_detector import LATE_S
from services.supervisor.live_view import live_view
from services.supervisor.managed_process import describe_exit, last_lines
from services.supervisor.parent_death import OrphanCleanup
from services.supervisor.restarts import ProcessFailure, Recovery, RestartBudget, judge
from services.supervisor.restore_state import restore_state
from services.supervisor.screen import Screen
from sim.evaluation.summary import Summary

TICK_S = 0.05
READY_S = 60.0  # from its start to its first word: the slowest needs 2 s on busy cores, cold code included 30
BACK_S = READY_S  # from a restart to the first message; beyond it has failed again
LISTENING = {"router", "recorder"}
"""Without whom no event is recorded."""
RECONNECTED_S = 1.0  # from a router's return until all others have found it again


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """How a run went. ``why`` and the failed child's last lines are empty where it completed.

    ``summary`` is None where it did not come as far as a cycle of the controller.
    """

    completed: bool
    exit_code: int
    why: str = ""
    last_lines: tuple[str, ...] = ()
    summary: Summary | None = None


class _Failed(Exception):
    def __init__(self, why: str, last_lines: tuple[str, ...] = (), *, in_order: bool = False) -> None:
        self.why = why
        self.last_lines = last_lines
        self.in_order = in_order


OnBus: TypeAlias = Callable[[BusOptions], None]
"""Told how the run's bus is reached, once there is one."""


def run(
    run_config: RunConfig,
    folder: RunFolder,
    screen: Screen,
    *,
    certs: Path | None = None,
    on_bus: OnBus | None = None,
) -> Outcome:
    """Run it into ``folder``. To be called from the main thread: signals come to it, and children live with it.

    ``certs`` is a folder of certificates, checked: with one all links are mTLS, and every process has its role.
    """
    supervisor = Supervisor(run_config, folder, screen, certs, on_bus)
    try:
        outcome = supervisor.run()
        for line in (outcome.why, *(f"    {text}" for text in outcome.last_lines)):
            if line:
                screen.say(line)
    finally:
        screen.close()
    return outcome


class Supervisor:
    """One run."""

    def __init__(
        self,
        run_config: RunConfig,
        folder: RunFolder,
        screen: Screen,
        certs: Path | None = None,
        on_bus: OnBus | None = None,
    ) -> None:
        self._run_config = run_config
        self._certs = certs
        self._on_bus = on_bus
        self._folder = folder
        self._logs = folder.path / "logs"
        self._logs.mkdir(exist_ok=True)
        self._screen = screen
        self._started = time.monotonic()
        self._ticked = self._started
        self._working = False  # every process has said that it is ready
        self._watch: BusMonitor | None = None
        self._out: Outbox
        self._unsaid: list[RunEvent] = []
        self._say_from_s = 0.0
        self._budget = RestartBudget()
        self._recovering: dict[str, Recovery] = {}
        self._last_drops = 0
        self._guard: OrphanCleanup
        self._crew: ChildProcesses
        self._request: StopRequest
        self.restarts = 0

    def run(self) -> Outcome:
        """From the first process to the last, and the summary: also of a run that was cut off, as far as it came."""
        with stop_on_signals() as self._request:
            outcome = self._supervise()
        if not self._folder.recording.exists():
            return outcome
        for text in join.segments_of(self._folder.recording):
            self._screen.say(text)
        summary, water = summarise_recording(
            self._run_config, self._folder.recording, restarts=self.restarts, unrecorded=self._last_drops
        )
        if summary.cycles == 0:
            return outcome
        self._folder.write_result(summary, water)
        return replace(outcome, summary=summary)

    def _supervise(self) -> Outcome:
        in_order = False
        with ExitStack() as sessions:
            self._guard = OrphanCleanup()
            self._crew = ChildProcesses(self._folder.scenario, self._logs, self._guard)
            try:
                self._warm()
                self._load()
                self._start(sessions)
                self._await(self._plant_is_done, None, "")
                in_order = True
            except _Failed as failure:
                in_order = failure.in_order
                return Outcome(completed=False, exit_code=FAILED, why=failure.why, last_lines=failure.last_lines)
            except Stopped:
                code = INTERRUPTED if self._request.interrupted else FAILED
                return Outcome(
                    completed=False, exit_code=code, why="stopped early; the messages recorded so far are kept"
                )
            finally:
                self._crew.close()
                killed = shutdown.stop(self._crew.children, in_order=in_order, close_session=sessions.close)
                self._guard.close()
                if self._watch is not None and (word := self._watch.newest(NodeStatus, "recorder")) is not None:
                    self._last_drops = word.dropped
        return self._last_look(killed)

    def _last_look(self, killed: Sequence[str]) -> Outcome:
        """The run came to its end: so must every process have, by itself and without a complaint."""
        for name, child in self._crew.children.items():
            code = child.exit_code()
            if name in self._recovering:
                why = f"{name} {self._recovering[name].fault.how}, and had not recovered by the end; its last lines:"
                return Outcome(completed=False, exit_code=FAILED, why=why, last_lines=child.last_lines())
            if name in killed or code != DONE:
                how = "did not stop and was killed" if code is None or name in killed else describe_exit(code)
                why = f"{name} {how}; its last lines:"
                return Outcome(completed=False, exit_code=FAILED, why=why, last_lines=child.last_lines())
        return Outcome(completed=True, exit_code=DONE)

    # --- starting ----------------------------------------------------------------------------------------------------

    def _warm(self) -> None:
        if jit_cache.is_warm():
            return
        self._screen.say("compiling, once after a change of the sources: a minute or two")
        log = self._logs / "compiling.log"
        process = jit_cache.fill(self._folder.scenario, log)
        self._guard.watch(process.pid)
        try:
            while process.poll() is None:
                self._tick()
                self._screen.wait("compiling", jit_cache.share())
            if process.returncode != 0:
                raise _Failed(f"compiling {describe_exit(process.returncode)}; its last lines:", last_lines(log))
        finally:
            process.kill()
            process.wait()
            self._guard.release(process.pid)

    def _load(self) -> None:
        self._crew.load()
        for row in process_table.processes(self._run_config.scenario):
            importlib.import_module(row.module)  # for its config, while the fork server loads the same
        if (forks := self._crew.forks) is None:
            return
        while not forks.is_loaded():
            if (code := forks.exit_code()) is not None:
                raise _Failed(f"loading {describe_exit(code)}; its last lines:", last_lines(forks.log))
            self._tick()

    def _start(self, sessions: ExitStack) -> None:
        endpoint = f"{SECURE if self._certs else 'tcp'}/127.0.0.1:{loopback.free_port()}"
        namespace = f"auv/{secrets.token_hex(4)}"
        certs = None if self._certs is None else self._certs.absolute()
        place = process_table.RunContext(folder=self._folder, router=endpoint, namespace=namespace, certs=certs)
        rows = process_table.processes(self._run_config.scenario)
        configs = {row.name: process_table.config_of(row.name, self._run_config, place) for row in rows}
        for row in (row for row in rows if not row.needs):
            self._crew.start(row, configs[row.name])
        self._await(lambda: loopback.answers(endpoint), "router", "does not answer")
        options = BusOptions(connect=(endpoint,), namespace=namespace, certs=self._certs, role=LAUNCHER)
        if self._on_bus is not None:
            self._on_bus(options)
        session = open_session(options, stop=self._request, say=self._screen.say)
        sessions.enter_context(session)
        watch = self._listen(session, rows)
        for row in (row for row in rows if row.needs):
            for name in row.needs:
                self._await(lambda name=name: watch.newest(NodeStatus, name) is not None, name, "not ready")  # type: ignore[misc]
            self._crew.start(row, configs[row.name])
        for row in rows:
            if row.name != "router":
                self._await(lambda row=row: watch.newest(NodeStatus, row.name) is not None, row.name, "not ready")  # type: ignore[misc]
        self._working = True

    def _listen(self, session: Session, rows: Sequence[process_table.ProcessRow]) -> BusMonitor:
        self._out = Outbox(session, node=LAUNCHER, epoch=new_epoch(), kinds=(RunEvent,))
        self._watch = BusMonitor(session, [row.name for row in rows])
        return self._watch

    # --- watching ----------------------------------------------------------------------------------------------------

    def _await(self, ready: Callable[[], bool], name: str | None, failure: str) -> None:
        """Tick until ``ready``. With a ``name`` that must be within ``READY_S``, else that child has failed."""
        until = time.monotonic() + READY_S
        while not ready():
            if name is not None and time.monotonic() > until:
                lines = self._crew.children[name].last_lines()
                raise _Failed(f"{name}: {failure} within {READY_S:.0f} s", lines)
            self._tick()

    def _plant_is_done(self) -> bool:
        plant = self._crew.children.get("plant")
        return plant is not None and plant.exit_code() == DONE

    def _tick(self) -> None:
        """Look after everyone once. Raises ``_Failed``, or ``Stopped`` after a signal."""
        self._crew.listen(TICK_S, self._request)
        if self._request():
            raise Stopped
        now_s = time.monotonic()
        late, self._ticked = now_s - self._ticked > LATE_S, now_s
        for name, child in tuple(self._crew.children.items()):
            if late:
                child.heartbeat.excuse(now_s)
            if (fault := self._fault_of(name, now_s)) is not None:
                self._mend(fault)
        if self._watch is None:
            return
        for name in self._watch.kills():
            if name in self._crew.children:  # and then it is a fault as any other
                self._crew.children[name].kill()
        self._look_after_recoveries(self._watch, now_s)
        if not self._recovering:  # whoever is being mended needs the processor sooner
            self._crew.keep_loaded()
        for event in self._watch.events():
            if event.node != LAUNCHER:
                self._show(event)
        self._screen.update(live_view(self._run_config, self._watch, self._states(), now_s - self._started))

    # --- who is dead -------------------------------------------------------------------------------------------------

    def _fault_of(self, name: str, now_s: float) -> ProcessFailure | None:
        """A child that is dead, or hangs and is therefore ended here and now."""
        child = self._crew.children[name]
        alive_s = child.heartbeat.last_s or now_s
        code = child.exit_code()
        if code is None:
            if self._plant_is_done() or not child.heartbeat.hung(now_s, child.starved_s) or child.waits_for_the_disk():
                return None
            child.kill()
            return ProcessFailure(name, f"hung: no heartbeat for {now_s - alive_s:.2f} s", alive_s, now_s)
        if (name == "plant" and code == DONE) or self._plant_is_done():
            return None
        return ProcessFailure(name, describe_exit(code), alive_s, now_s)

    def _mend(self, fault: ProcessFailure) -> None:
        name = fault.node
        refusal = judge(fault, restartable=self._crew.restartable(name), had_worked=self._working, budget=self._budget)
        if refusal is not None:
            lines = self._crew.children[name].last_lines()
            raise _Failed(f"{refusal.why}; its last lines:", lines, in_order=refusal.in_order)
        assert self._watch is not None
        before = self._watch.last_activity(name)
        self._crew.restart(name, restore_state(name, self._watch))
        self.restarts += 1
        began_s = fault.alive_s if name not in self._recovering else self._recovering[name].fault.alive_s
        self._recovering[name] = Recovery(
            fault._replace(alive_s=began_s), before=0 if before is None else before.epoch, begun_s=time.monotonic()
        )
        self._tell(
            "fault", f"{name} {fault.how}; detected {fault.seen_s - fault.alive_s:.2f} s after its last heartbeat"
        )

    def _look_after_recoveries(self, watch: BusMonitor, now_s: float) -> None:
        for name, recovery in tuple(self._recovering.items()):
            sign = watch.last_activity(name)
            if sign is not None and recovery.is_over(sign.epoch, sign.arrived_s):
                del self._recovering[name]
                fault = recovery.fault
                took_s = sign.arrived_s - fault.alive_s
                self._say_from_s = now_s + RECONNECTED_S if name in LISTENING else self._say_from_s
                self._tell("restart", f"{name} {fault.how}; recovered {took_s:.2f} s after its last heartbeat")
            elif now_s - recovery.begun_s > BACK_S:
                self._crew.children[name].kill()
                self._mend(
                    ProcessFailure(name, f"did not recover within {BACK_S:.0f} s", recovery.fault.alive_s, now_s)
                )
        if self._unsaid and now_s >= self._say_from_s and not self._recovering.keys() & LISTENING:
            for event in self._unsaid:
                self._out.publish(event)
            self._unsaid.clear()

    def _tell(self, kind: str, text: str) -> None:
        """On the screen now, into the recording as soon as there is one again and a way to it."""
        assert self._watch is not None
        event = RunEvent(t_ns=self._watch.t_ns() or 0, node=LAUNCHER, kind=kind, text=text)
        self._show(event)
        self._unsaid.append(event)

    def _show(self, event: RunEvent) -> None:
        self._screen.say(f"{event.t_ns / 1e9:.1f} s  {event.node}: {event.text}")

    def _states(self) -> dict[str, str]:
        assert self._watch is not None
        running = self._watch.running()
        states = {}
        for name, child in self._crew.children.items():
            if (code := child.exit_code()) is not None:
                states[name] = "ended" if code == DONE else "failed"
            elif name in self._recovering:
                states[name] = "restarting"
            elif name == "router" or self._watch.newest(NodeStatus, name) is not None:
                states[name] = "running" if running else "ready"
            else:
                states[name] = "spawned"
        return states
