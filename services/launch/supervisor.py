"""The launcher: starts every process of a run, watches, stops them in order, and says truthfully how it went.

Plant, sensors and the rest run until the plant has done its last step; a child that dies before, never gets ready or
falls silent fails the run, named, with its last lines. Ctrl-C ends everything within two seconds. The recorder is
stopped last, so that it hears the last word of all others.
"""

from __future__ import annotations

import secrets
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

from ltv_mpc.signals import Clock, ClockState, NodeStatus
from services.bus.roles import LAUNCHER
from services.bus.session import SECURE, BusOptions, Stopped, open_session
from services.launch import ending, loopback, table, warm
from services.launch.children import Child, how_it_ended, last_lines
from services.launch.live import view_of
from services.launch.orphans import Guard
from services.launch.watch import Watch
from services.process.stopping import DONE, FAILED, INTERRUPTED, StopRequest, stop_on_signals
from services.run.folder import RunFolder
from services.run.situation import Situation
from services.run.summary import of_recording
from services.views.live import Screen
from sim.grading.summary import Summary

TICK_S = 0.05
READY_S = 60.0  # from its start to its first word: the slowest needs 2 s on busy cores, cold code included 30
SILENT_S = 10.0
LATE_TICK_S = 1.0  # the supervisor itself was stopped or starved: silence says nothing then


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
    def __init__(self, why: str, last_lines: tuple[str, ...] = ()) -> None:
        self.why = why
        self.last_lines = last_lines


def run(situation: Situation, folder: RunFolder, screen: Screen, *, certs: Path | None = None) -> Outcome:
    """Run it into ``folder``. To be called from the main thread: signals come to it, and children live with it.

    ``certs`` is a folder of certificates, checked: with one all links are mTLS, and every process has its role.
    """
    supervisor = Supervisor(situation, folder, screen, certs)
    try:
        outcome = supervisor.run()
        for line in (outcome.why, *(f"    {text}" for text in outcome.last_lines)):
            if line:
                screen.say(line)
    finally:
        screen.close()
    return outcome


class Supervisor:
    """One run. ``children`` are by name, in the order of their start."""

    def __init__(self, situation: Situation, folder: RunFolder, screen: Screen, certs: Path | None = None) -> None:
        self._situation = situation
        self._certs = certs
        self._folder = folder
        self._logs = folder.path / "logs"
        self._logs.mkdir(exist_ok=True)
        self._screen = screen
        self._started = time.monotonic()
        self._ticked = self._started
        self._watch: Watch | None = None
        self._guard: Guard
        self._request: StopRequest
        self.children: dict[str, Child] = {}

    def run(self) -> Outcome:
        """From the first process to the last, and the summary: also of a run that was cut off, as far as it came."""
        with stop_on_signals() as self._request:
            outcome = self._supervise()
        if not self._folder.recording.exists():
            return outcome
        summary, water = of_recording(self._situation, self._folder.recording)
        if summary.cycles == 0:
            return outcome
        self._folder.write_result(summary, water)
        return replace(outcome, summary=summary)

    def _supervise(self) -> Outcome:
        in_order = False
        with ExitStack() as sessions:
            self._guard = Guard()
            try:
                self._warm()
                self._start(sessions)
                self._await(self._plant_is_done, None, "")
                in_order = True
            except _Failed as failure:
                return Outcome(completed=False, exit_code=FAILED, why=failure.why, last_lines=failure.last_lines)
            except Stopped:
                code = INTERRUPTED if self._request.interrupted else FAILED
                return Outcome(completed=False, exit_code=code, why="stopped; what was recorded until then is kept")
            finally:
                killed = ending.stop(self.children, in_order=in_order, close_session=sessions.close)
                self._guard.close()
        return self._last_look(killed)

    def _last_look(self, killed: Sequence[str]) -> Outcome:
        """The run came to its end: so must every process have, by itself and without a complaint."""
        for name, child in self.children.items():
            code = child.exit_code()
            if name in killed or code != DONE:
                how = "did not stop and was killed" if code is None or name in killed else how_it_ended(code)
                why = f"{name} {how}; its last lines:"
                return Outcome(completed=False, exit_code=FAILED, why=why, last_lines=child.last_lines())
        return Outcome(completed=True, exit_code=DONE)

    # --- starting ----------------------------------------------------------------------------------------------------

    def _warm(self) -> None:
        if warm.is_warm():
            return
        self._screen.say("compiling, once after a change of the sources: about half a minute")
        log = self._logs / "compiling.log"
        process = warm.fill(self._folder.scenario, log)
        self._guard.watch(process.pid)
        try:
            while process.poll() is None:
                self._tick()
            if process.returncode != 0:
                raise _Failed(f"compiling {how_it_ended(process.returncode)}; its last lines:", last_lines(log))
        finally:
            process.kill()
            process.wait()
            self._guard.release(process.pid)

    def _start(self, sessions: ExitStack) -> None:
        endpoint = f"{SECURE if self._certs else 'tcp'}/127.0.0.1:{loopback.free_port()}"
        namespace = f"auv/{secrets.token_hex(4)}"
        places = {
            "router": endpoint,
            "namespace": namespace,
            "run": str(self._folder.path.absolute()),
            "compute_delay_s": repr(self._situation.scenario.run.compute_delay_s),
        }
        if self._certs is not None:
            places["certs"] = str(self._certs.absolute())
        rows = table.processes(self._situation.scenario)
        for row in (row for row in rows if not row.needs):
            self._spawn(row, places)
        self._await(lambda: loopback.answers(endpoint), "router", "does not answer")
        options = BusOptions(connect=(endpoint,), namespace=namespace, certs=self._certs, role=LAUNCHER)
        session = open_session(options, stop=self._request, say=self._screen.say)
        sessions.enter_context(session)
        watch = self._watch = Watch(session, [row.name for row in rows])
        for row in (row for row in rows if row.needs):
            for name in row.needs:
                self._await(lambda name=name: watch.newest(NodeStatus, name) is not None, name, "never got ready")  # type: ignore[misc]
            self._spawn(row, places)
        for row in rows:
            if row.name != "router":
                self._await(lambda row=row: watch.newest(NodeStatus, row.name) is not None, row.name, "never got ready")  # type: ignore[misc]

    def _spawn(self, row: table.Process, places: dict[str, str]) -> None:
        command = table.command(row, places)
        self.children[row.name] = Child(row.name, command, log=self._logs / f"{row.name}.log", guard=self._guard)

    # --- watching ----------------------------------------------------------------------------------------------------

    def _await(self, ready: Callable[[], bool], name: str | None, failure: str) -> None:
        """Tick until ``ready``. With a ``name`` that must be within ``READY_S``, else that child has failed."""
        until = time.monotonic() + READY_S
        while not ready():
            if name is not None and time.monotonic() > until:
                raise _Failed(f"{name}: {failure} within {READY_S:.0f} s", self.children[name].last_lines())
            self._tick()

    def _plant_is_done(self) -> bool:
        return self.children["plant"].exit_code() == DONE

    def _tick(self) -> None:
        """Look after everyone once. Raises ``_Failed``, or ``Stopped`` after a signal."""
        if self._request.wait(TICK_S):
            raise Stopped
        for name, child in self.children.items():
            code = child.exit_code()
            if code is not None and not (name == "plant" and code == DONE):
                raise _Failed(f"{name} {how_it_ended(code)}; its last lines:", child.last_lines())
        now = time.monotonic()
        in_time = now - self._ticked < LATE_TICK_S
        self._ticked = now
        if self._watch is None:
            return
        for event in self._watch.events():
            self._screen.say(f"{event.t_ns / 1e9:.1f} s  {event.node}: {event.text}")
        for name in self.children:
            silent_s = self._watch.silent_s(name)
            if in_time and silent_s is not None and silent_s > SILENT_S and not self._plant_is_done():
                raise _Failed(f"{name}: not a word for {silent_s:.0f} s", self.children[name].last_lines())
        self._screen.update(view_of(self._situation, self._watch, self._states(), now - self._started))

    def _states(self) -> dict[str, str]:
        assert self._watch is not None
        clock = self._watch.newest(Clock)
        running = clock is not None and clock.state is ClockState.RUNNING
        states = {}
        for name, child in self.children.items():
            if (code := child.exit_code()) is not None:
                states[name] = "ended" if code == DONE else "failed"
            elif name == "router" or self._watch.newest(NodeStatus, name) is not None:
                states[name] = "running" if running else "ready"
            else:
                states[name] = "spawned"
        return states
