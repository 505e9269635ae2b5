"""Supervisor of one run: starts all processes, restarts failed ones, stops them in order, and reports the outcome.

    prepare  router and live page, then compiled code if it is missing                   ``jit_cache.py``
    start    the recorder, then the others; each must report ready                       ``process_table.py``
    watch    heartbeats, failures, restarts, screen, until the plant's last step         ``process_group.py``
             the summary of what is recorded so far                                      ``run/summary.py``
    stop     nodes, then the recorder, which records all last messages, then the router  ``process_group.py``

Estimator, controller, recorder and router are restarted if they die or hang. Plant and sensors are the simulated world:
if one of them fails, the run ends. Ctrl-C ends all processes within two seconds. No process outlives the supervisor
(``parent_death.py``).
"""

from __future__ import annotations

import secrets
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec

from ltv_mpc.errors import ConfigError, format_value, one_line
from ltv_mpc.messages import Kill, NodeStatus, RunEvent
from services.bus.options import SECURE, BusOptions
from services.bus.outbox import Outbox, new_epoch
from services.bus.roles import ROUTER, SUPERVISOR
from services.bus.session import Stopped, open_session
from services.recording import recover
from services.recording.records import report_progress
from services.run.folder import DELETED, RunFolder
from services.run.run_config import RunConfig
from services.run.summary import STOPPED, GrowingSummary, summarise_recording
from services.runtime.stopping import DONE, FAILED, INTERRUPTED, StopRequest, stop_on_signals
from services.supervisor import jit_cache, loopback, process_table
from services.supervisor.bus_monitor import BusMonitor
from services.supervisor.child import describe_exit, last_lines
from services.supervisor.process_group import ProcessGroup, RunFailed
from services.supervisor.screen import LivePage, Screen
from sim.evaluation.summary import Summary

TICK_S = 0.05
READY_TIMEOUT_S = 60.0
"""Longest time from a process's start to its first status. The slowest process needs 2 s on busy cores, or 30 s if it
must compile."""
LOADING_TIMEOUT_S = 20.0
QUICK_S = 1.0
"""Time from which a summary shows its progress."""
SKIPPED = "the summary was skipped; `ltv-mpc report` computes it from the recording"
DRAWING_TIMEOUT_S = 5.0
"""Longest time for which the clock waits for the first drawing of a page that is open in a browser."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """Outcome of a run. ``why`` and the last log lines of the failed process are empty if the run completed.

    ``summary`` is None if nothing was recorded.
    """

    exit_code: int = DONE
    why: str = ""
    last_lines: tuple[str, ...] = ()
    summary: Summary | None = None

    def failed(self, why: str, code: int = FAILED) -> Outcome:
        """Return the outcome of a run that has also failed in this way. The first failure is the one that is named."""
        return replace(self, exit_code=self.exit_code or code, why=self.why or why)


class Supervisor:
    """Supervisor of one run, which writes its recording and summary into ``folder``.

    Use it in the main thread: it receives the signals, and the kernel ties the children to it. ``page`` is started as
    soon as the router listens.
    """

    def __init__(self, run_config: RunConfig, folder: RunFolder, screen: Screen, page: LivePage | None = None) -> None:
        self._run_config = run_config
        self._folder = folder
        self._screen = screen
        self._page = page
        self._logs.mkdir(exist_ok=True)
        self._started_s = time.monotonic()
        self._request: StopRequest
        self._signals_at_stop: int | None = None
        """Number of signals up to the one that has ended the run; None if no signal has."""
        self.processes: ProcessGroup
        self._monitor: BusMonitor | None = None  # None before the connection to the bus
        self._summary: GrowingSummary | None = None  # None before there is a recording

    def run(self, certs: Path | None = None) -> Outcome:
        """Run from the first process to the last and write the summary, also of a run that was interrupted.

        ``certs`` is a folder of checked certificates: with it all links use mutual TLS and each process has its role.
        """
        try:
            with stop_on_signals() as self._request:
                outcome = self._supervise(certs)
                if self._folder.recording.exists():
                    outcome = self._summarised(outcome)
            if outcome.why:
                self._screen.say(f"{outcome.why}{'; its last lines:' if outcome.last_lines else ''}")
            for text in outcome.last_lines:
                self._screen.say(f"    {text}")
        finally:
            self._screen.close()
        return outcome

    def _summarised(self, outcome: Outcome) -> Outcome:
        """Write the summary and show the progress of a long one. A signal skips it.

        After Ctrl-C a second one does, also while the processes are still stopping.
        """
        begun_s = time.monotonic()
        handled = self._request.signals if self._signals_at_stop is None else self._signals_at_stop

        def progress(share: float) -> None:
            if self._request.signals > handled:
                raise Stopped
            if time.monotonic() - begun_s > QUICK_S:
                self._screen.wait("summary", share)

        try:
            with report_progress(progress):
                return self._with_summary(outcome, progress)
        except Stopped:
            outcome, code, why = replace(outcome, exit_code=0), self._stop_code, SKIPPED
        except (ConfigError, OSError) as error:
            code, why = FAILED, str(error)
        if outcome.why:
            self._screen.say(why)
        return outcome.failed(why, code)

    def _with_summary(self, outcome: Outcome, progress: Callable[[float], None]) -> Outcome:
        """Join the segments of the recording and write the summary. Return the outcome with the summary."""
        joined = list(recover.join(self._folder.recording))
        for text in joined:
            self._screen.say(text)
        why = outcome.why
        if why and self._page is not None:
            self._page.show(f"failed: {one_line(why)}")
        recorder = None if self._monitor is None else self._monitor.newest(NodeStatus, "recorder")
        found = None if joined or self._summary is None else self._summary.result(progress)
        summary, water = found or summarise_recording(self._run_config, self._folder.recording)
        dropped = max(summary.messages.dropped, 0 if recorder is None else recorder.dropped)
        summary = msgspec.structs.replace(
            summary,
            restarts=len(self.processes.restarts_s),
            messages=msgspec.structs.replace(summary.messages, dropped=dropped),
            completed=summary.completed and not why,
            why=why or summary.why,
        )
        if summary.cycles == 0:
            outcome = outcome.failed(f"{self._folder.recording}: no cycle of the controller is recorded")
            summary = msgspec.structs.replace(summary, completed=False, why=outcome.why)
        outcome = replace(outcome, summary=summary)
        try:
            self._folder.write_result(summary, water)
        except OSError as error:
            return outcome.failed(f"{self._folder.path}: the results cannot be written: {error.strerror}")
        return outcome

    @property
    def _stop_code(self) -> int:
        """Exit code of a run that a signal has ended."""
        return INTERRUPTED if self._request.interrupted else FAILED

    @property
    def _logs(self) -> Path:
        return self._folder.path / "logs"

    def _supervise(self, certs: Path | None) -> Outcome:
        in_order = False
        with ExitStack() as sessions:
            self.processes = ProcessGroup(self._folder.scenario, self._logs, self._screen)
            try:
                bus = self._open_bus(certs)
                self._fill_jit_cache()
                self._load()
                self._start(sessions, bus)
                while not self.processes.run_complete:
                    self._tick()
                in_order = True
            except RunFailed as failure:
                in_order = failure.in_order
                return self._ended_early(failure.why, FAILED, failure.last_lines)
            except Stopped:
                self._signals_at_stop = self._request.signals
                return self._ended_early(STOPPED, self._stop_code)
            finally:
                killed = self.processes.stop(in_order=in_order, close_session=sessions.close)
        return self._final_check(killed)

    def _ended_early(self, why: str, code: int, lines: tuple[str, ...] = ()) -> Outcome:
        """Say in the recording why the run ends before its end."""
        if self._monitor is not None:
            self.processes.end(why)
        return Outcome(exit_code=code, why=why, last_lines=lines)

    def _final_check(self, killed: Sequence[str]) -> Outcome:
        """Check that every process ended by itself and without an error, now that the run is complete."""
        for name, child in self.processes.by_name.items():
            code, failure = child.exit_code(), self.processes.recovering.get(name)
            if failure is not None:
                how = f"{failure.how}, and had not recovered by the end"
            elif code is None or name in killed:
                how = "did not stop and was killed"
            elif code != DONE:
                how = describe_exit(code)
            else:
                continue
            why = f"{name} {how}"
            return Outcome(exit_code=FAILED, why=why, last_lines=last_lines(child.log))
        return Outcome()

    # --- starting ----------------------------------------------------------------------------------------------------

    def _open_bus(self, certs: Path | None) -> BusOptions:
        """Start the router and then the live page, before anything is compiled or loaded.

        Return the options with which the supervisor connects.
        """
        router = f"{SECURE if certs else 'tcp'}/127.0.0.1:{loopback.free_port()}"
        bus = BusOptions(
            connect=(router,),
            namespace=f"auv/{secrets.token_hex(4)}",
            certs=None if certs is None else certs.absolute(),
            role=SUPERVISOR,
        )
        self._start_process(process_table.PROCESSES[0], bus)
        heartbeats = self.processes.by_name[ROUTER].hang_detector
        self._wait_until(lambda: heartbeats.last_s is not None, ROUTER, "not ready")  # it beats once it listens
        if self._page is not None:
            self._page.start(bus)
        return bus

    def _fill_jit_cache(self) -> None:
        """Compile all numba kernels into the cache, unless they are there already."""
        if jit_cache.is_warm():
            return
        self._screen.say(jit_cache.NOTE)
        log, begun_s = self._logs / "compiling.log", time.monotonic()

        def wait(share: float) -> None:
            self._tick()
            self._screen.wait("compiling", share)
            if self._page is not None:
                self._page.show(f"{jit_cache.NOTE}; {share:.0%} after {time.monotonic() - begun_s:.0f} s")

        code = jit_cache.fill(self._folder.scenario, log, wait)
        if code != DONE:
            raise RunFailed(f"compiling {describe_exit(code)}", last_lines(log))

    def _load(self) -> None:
        """Wait until the fork server has loaded; after ``LOADING_TIMEOUT_S`` the processes are spawned without it."""
        if self._page is not None:
            self._page.show("starting the processes")
        forks, until = self.processes.forks, time.monotonic() + LOADING_TIMEOUT_S
        forks.load()
        while not forks.is_loaded() and time.monotonic() < until:
            if (code := forks.exit_code()) is not None:
                raise RunFailed(f"loading {describe_exit(code)}", last_lines(forks.log))
            self._tick()

    def _start(self, sessions: ExitStack, bus: BusOptions) -> None:
        """Start the processes in the order of the table, the recorder first."""
        rows = process_table.processes(self._run_config.scenario)
        session = sessions.enter_context(open_session(bus, stop=self._request, say=self._screen.say))
        monitor = self._monitor = BusMonitor(session, [row.name for row in rows])
        self.processes.connect(monitor, Outbox(session, node=SUPERVISOR, epoch=new_epoch(), kinds=(RunEvent,)))
        others = rows[1:]  # the router runs

        def wait_until_ready(name: str) -> None:
            self._wait_until(lambda: monitor.newest(NodeStatus, name) is not None, name, "not ready")

        for row in others:
            if row is others[1]:
                wait_until_ready(others[0].name)  # the recorder: it records the first message of all others
                self._summary = GrowingSummary(self._run_config, self._folder.recording)
            if row is others[-1]:
                self._wait_for_drawing()  # the clock starts when the last process is ready
            self._start_process(row, bus)
        for row in others:
            wait_until_ready(row.name)
        self.processes.all_ready = True

    def _start_process(self, row: process_table.ProcessRow, bus: BusOptions) -> None:
        self.processes.start(row, process_table.config_of(row.name, self._run_config, self._folder, bus))

    def _wait_for_drawing(self) -> None:
        """Wait until the page is drawn, so that who has opened it sees the first seconds."""
        until = time.monotonic() + DRAWING_TIMEOUT_S
        while self._page is not None and self._page.awaited and time.monotonic() < until:
            self._tick()

    # --- watching ----------------------------------------------------------------------------------------------------

    def _wait_until(self, condition: Callable[[], bool], name: str, failure: str) -> None:
        """Tick until ``condition`` holds; the process ``name`` fails after ``READY_TIMEOUT_S``."""
        until = time.monotonic() + READY_TIMEOUT_S
        while not condition():
            if time.monotonic() > until:
                lines = last_lines(self.processes.by_name[name].log)
                raise RunFailed(f"{name}: {failure} within {READY_TIMEOUT_S:.0f} s", lines)
            self._tick()

    def _tick(self) -> None:
        """Check all processes once. Raises ``RunFailed``, or ``Stopped`` after a signal."""
        self.processes.wait(TICK_S, self._request)
        if self._request():
            raise Stopped
        if self._folder.deleted:
            raise RunFailed(f"{self._folder.path}: {DELETED}")
        now_s = time.monotonic()
        self.processes.check(now_s)
        if (monitor := self._monitor) is None:
            return
        for notice in monitor.notices():
            match notice:
                case Kill(node=name) if name in self.processes.by_name:  # handled as any other failure
                    self.processes.by_name[name].kill()
                case Kill(node=name):
                    self._screen.say(one_line(f"kill refused: no process {format_value(name)} in this run"))
                case RunEvent() if notice.node != SUPERVISOR:
                    self.processes.show(notice)
        self.processes.check_recoveries(now_s)
        if not self.processes.recovering:  # a restarted process needs the processor more
            self.processes.forks.load()
        run, wall_s = self._run_config.scenario, now_s - self._started_s
        self._screen.update(monitor.view(self.processes.states(), wall_s, start_ns=run.start_ns, end_ns=run.end_ns))
