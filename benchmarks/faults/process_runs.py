"""Runs of processes with faults, at twice real time: attacked, or with an injector between the controller and the rest.

attacked        ``ltv-mpc sim`` whose processes are attacked when the run's clock reaches the time of a fault; a process
                is found by its parent and its name, and the run receives no notice of it; half of the
                runs are ended by a signal
behind injector two routers, with the controller alone at the second one; the recording at A holds what the controller
                received, except for messages that were harmed on their way to B:

                plant, sensors, estimator, recorder -- router A -- inject -- router B -- controller

crash           SIGKILL
hang            SIGSTOP, without SIGCONT
slow            stopped for a share of each period, too short to count as hung
helper stopped  SIGSTOP, until the end of the run: the fork server or the orphan cleanup
flood           frames of unknown keys, or of a program beside the run
full disk       no file of the process may grow beyond its present size for some time (RLIMIT_FSIZE)
"""

from __future__ import annotations

import itertools
import json
import os
import resource
import secrets
import signal
import subprocess
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path

import msgspec

from benchmarks.faults import inject
from benchmarks.faults.draw import Run
from benchmarks.faults.kinds import Fault
from benchmarks.faults.lockstep import SCENARIO, run_config
from benchmarks.faults.message_faults import MessageFault
from benchmarks.faults.recorded import Ended, Injected
from benchmarks.processes import Process, Started, await_router, descendants, end
from ltv_mpc.messages import Clock, ClockState, RunEvent
from services.bus.options import BusOptions
from services.bus.roles import DISPLAY, SUPERVISOR
from services.bus.session import Session, open_session
from services.bus.topics import BY_TYPE, Topic
from services.bus.wire import Header, WireError, decode, encode
from services.processes import plant
from services.run import folder as run_folder
from services.runtime.clock import ClockError, VehicleClock, monotonic_us
from services.supervisor import entry_point, loopback, process_table

SPEED = 2.0
"""Vehicle seconds per wall second."""

START_S, END_S = 90.0, 30.0
"""Longest wait for the start of a run, on a machine with other load, and for the exit of its processes at its end."""

POLL_S = 0.02
"""Time between two looks at the run's clock and process (s)."""

STOP_S = 10.0
LONGER_S = 300.0
"""Duration of a run beyond the signal that ends it."""

SIGNALS = {signal.SIGINT: 130, signal.SIGTERM: 1}
"""Signals that end a run, with its exit code."""

GONE_S = 3.0
"""Time after a run's end within which the orphan cleanup has ended what is left."""

FLOOD_PERIOD_S = 0.02
FLOOD_KEYS = 50

SLOW_PERIOD_S = 0.25
FULL_S = 2.0
"""Wall time for which the disk stays full."""

PAGE = 4096

UNDER_TEST = "controller"
IN_ORDER = ("plant", "sensors", "estimator", UNDER_TEST, "inject", "recorder", "router", "router-b")
"""Order in which processes are stopped: the recorder receives the last messages of all others."""


def patience_s(run: Run) -> float:
    """Return the longest wall time of a run."""
    return START_S + 2.0 * (run.duration_s + run.afloat_s) / SPEED


# --- attacked --------------------------------------------------------------------------------------------------------


def attacked(run: Run, folder: Path) -> Ended:
    """Run ``ltv-mpc sim`` while its processes are killed, stopped, slowed, flooded or refused disk space."""
    seed = run.faults[-1].seed if run.faults else 0
    number = [None, *SIGNALS, None][seed % 4]
    words = ["sim", SCENARIO, "--out", str(folder), "--json", "--speed", repr(SPEED), "--set", f"run.seed={run.seed}"]
    words += ["--duration-s", repr(run.duration_s + (LONGER_S if number else 0.0))]
    words += ["--surface-time-s", repr(run.afloat_s)]
    injected: list[Injected] = []
    with folder.with_suffix(".log").open("w+b") as log, Started() as started, ExitStack() as sessions:
        process = started.start("services.cli", *words, stderr=log)
        if (clock := _clock_of(process, folder, sessions)) is not None:
            for fault in run.faults:
                if not clock.reaches(fault.start_ns, process):
                    break
                injected.append(_attack(fault, process, clock))
            if number is not None and clock.reaches(round(run.duration_s * 1e9), process):
                process.send_signal(number)
        running, began_s, code = descendants(process.pid), time.monotonic(), None
        with suppress(subprocess.TimeoutExpired):
            code = process.wait(patience_s(run) + END_S)
        wait_s = None if number is None else time.monotonic() - began_s
        time.sleep(GONE_S if _alive(running) else 0.0)
        left = _alive(running)
        log.seek(0)
        expected = 0 if number is None else SIGNALS[number]
        why = "" if code == expected else f"exit code {code}: {log.read()[-500:].decode(errors='replace')}"
        return Ended(injected, f"{why} left: {', '.join(left)}" if left else why, summarised=True, wait_s=wait_s)


def _alive(processes: Mapping[int, str]) -> list[str]:
    """Return the names of those that still run."""
    return [name for pid, name in processes.items() if descendants(pid)]


def _attack(fault: Fault, process: Process, clock: _Time) -> Injected:
    at_us, at_ns, why = monotonic_us(), clock.now_ns() or fault.start_ns, ""
    lasts = partial(clock.is_before, fault.end_ns)
    harmed = 0
    try:
        if fault.kind == "flood":
            harmed = flood(fault, clock.session, lasts=lasts)
        else:
            attack(fault, _pid_of(fault.target, process), lasts=lasts)
    except ProcessLookupError as error:
        why = str(error)
    if fault.kind == "disk_full":  # no process can write before space is free again
        at_us = monotonic_us()
    return Injected(fault, at_ns, at_us, harmed=harmed, why=why)


def _pid_of(target: str, process: Process) -> int:
    """Return the pid of a process of the run. The orphan cleanup leads the process group of all others."""
    name = "ltv-plant" if target == "cleanup" else f"ltv-{target}"
    pid = next((pid for pid, found in descendants(process.pid).items() if found == name), None)
    if pid is None:
        raise ProcessLookupError(f"no process of {target} is running")
    return os.getpgid(pid) if target == "cleanup" else pid


def flood(fault: Fault, session: Session, *, lasts: Callable[[], bool]) -> int:
    """Publish frames at ``fault.size`` a second while ``lasts``; return their number."""
    keys = [f"flood/{i}" for i in range(FLOOD_KEYS)] if fault.target == "unknown" else ["event/flood"]
    publishers = itertools.cycle([session.publisher(key) for key in keys])
    event = RunEvent(t_ns=0, node=SUPERVISOR, kind="fault", text="flood")
    sent = 0
    while lasts():
        for publisher in itertools.islice(publishers, round(fault.size * FLOOD_PERIOD_S)):
            sent += 1
            publisher.put(encode(event, Header(epoch=fault.seed, sequence=sent, sent_monotonic_us=0)))
        time.sleep(FLOOD_PERIOD_S)
    return sent


def attack(fault: Fault, pid: int, *, lasts: Callable[[], bool]) -> None:
    """Attack process ``pid``; return at once, or when ``lasts`` returns False."""
    match fault.kind:
        case "process_crash" | "router_killed":
            os.kill(pid, signal.SIGKILL)
        case "process_hang" | "helper_stopped":
            os.kill(pid, signal.SIGSTOP)
        case "process_slow":
            with suppress(ProcessLookupError):  # it was taken for dead, and ended
                while lasts():
                    os.kill(pid, signal.SIGSTOP)
                    time.sleep(fault.size * SLOW_PERIOD_S)
                    os.kill(pid, signal.SIGCONT)
                    time.sleep((1.0 - fault.size) * SLOW_PERIOD_S)
        case "disk_full":
            _, most = resource.prlimit(pid, resource.RLIMIT_FSIZE)
            resource.prlimit(pid, resource.RLIMIT_FSIZE, (PAGE, most))
            time.sleep(FULL_S)
            with suppress(ProcessLookupError):
                resource.prlimit(pid, resource.RLIMIT_FSIZE, (most, most))
        case _:
            raise ValueError(f"{fault.kind} is not a fault of a process")


class _Time:
    """Vehicle time of the run, from its clock messages."""

    def __init__(self) -> None:
        self._clock = VehicleClock()
        self.state = ClockState.WAITING
        self.session: Session  # with the run

    def offer(self, topic: Topic | None, key: str, payload: bytes) -> None:  # noqa: ARG002  (there is one key)
        """Update the clock (called on the bus's thread)."""
        with suppress(WireError, ClockError):
            clock, _ = decode(Clock, payload)
            self._clock.follow(clock)
            self.state = clock.state

    def now_ns(self) -> int | None:
        """Return the vehicle time (ns); None before the run has a clock."""
        return self._clock.read(monotonic_us()) if self.state is not ClockState.WAITING else None

    def is_before(self, t_ns: int) -> bool:
        """Return True if the run has not reached this time (ns)."""
        return (self.now_ns() or t_ns - 1) < t_ns

    def reaches(self, t_ns: int, process: Process) -> bool:
        """Wait for a time (ns). Return False if the run's process has ended before."""
        while process.poll() is None and self.is_before(t_ns):
            time.sleep(POLL_S)
        return process.poll() is None


def _clock_of(process: Process, folder: Path, sessions: ExitStack) -> _Time | None:
    """Return the clock of a run, found by the router address in the plant's settings; None: the run never started."""
    until = time.monotonic() + START_S
    clock, connected = _Time(), False
    while process.poll() is None and time.monotonic() < until:
        if not connected:
            with suppress(OSError, msgspec.DecodeError):  # not there yet, or not all of it
                bus = entry_point.read_config(folder / "logs" / "plant.json", plant.Config).bus
                options = msgspec.structs.replace(bus, role=DISPLAY)
                clock.session = sessions.enter_context(open_session(options, stop=lambda: False, say=lambda _: None))
                clock.session.subscribe(BY_TYPE[Clock].key, BY_TYPE[Clock], clock)
                connected = True
        if clock.now_ns() is not None:
            return clock
        time.sleep(POLL_S)
    return None


# --- behind an injector ----------------------------------------------------------------------------------------------


def injection(fault: Fault) -> inject.Injection:
    """Convert a fault of the campaign to the injector's."""
    harm, times = MessageFault(fault.kind.removeprefix("message_")), {"start_s": fault.start_s, "end_s": fault.end_s}
    return inject.Injection(key=fault.target, harm=harm, size=fault.size, seed=fault.seed, **times)


def behind_injector(run: Run, folder: Path) -> Ended:
    """Run processes with an injector between the controller and all others; then stop every process."""
    of = run_config(run, f"run.speed={SPEED}")
    made = run_folder.make(SCENARIO, of.files, out=folder, force=False)
    logs = made.path / "logs"
    logs.mkdir()
    namespace = f"auv/{secrets.token_hex(4)}"
    a, b = (BusOptions(connect=(f"tcp/127.0.0.1:{loopback.free_port()}",), namespace=namespace) for _ in range(2))
    modules = {row.name: row.module for row in process_table.processes(of.scenario)}
    running: dict[str, Process] = {}
    with Started() as started:

        def start(name: str, module: str, config: msgspec.Struct) -> None:
            file = logs / f"{name}.json"
            entry_point.write_config(file, config)
            words = entry_point.__name__, str(os.getpid()), module, str(file)
            with file.with_suffix(".log").open("wb") as log:
                running[name] = started.start(*words, stdout=log, stderr=log)

        for name, bus in (("router", a), ("router-b", b)):
            start(name, modules["router"], process_table.config_of("router", of, made, bus))
            await_router(bus.connect[0])
        at_a, at_b = (msgspec.structs.replace(bus, mode="client", role=inject.NAME) for bus in (a, b))
        injections = tuple(map(injection, run.faults))
        link = str(made.path / inject.LINK)
        settings = inject.Config(node=UNDER_TEST, injections=injections, at_a=at_a, at_b=at_b, link=link)
        start("inject", inject.__name__, settings)
        for name in ("recorder", "plant", "sensors", "estimator", UNDER_TEST):
            start(name, modules[name], process_table.config_of(name, of, made, b if name == UNDER_TEST else a))
        with suppress(subprocess.TimeoutExpired):
            running["plant"].wait(patience_s(run))
        codes = {name: end(running[name], STOP_S) for name in IN_ORDER}
    last = {name: ((logs / f"{name}.log").read_text(errors="replace").splitlines() or [""])[-1] for name in codes}
    try:  # the last line of the injector's log is an account of the harmed messages by fault
        harmed = [int(entry["harmed"]) for entry in json.loads(last["inject"])]
    except (ValueError, TypeError, KeyError):
        harmed = [0] * len(run.faults)
    failed = {name: f"exit code {code}, {last[name][-200:]}" for name, code in codes.items() if code != 0}
    injected = [Injected(fault, fault.start_ns, harmed=count) for fault, count in zip(run.faults, harmed, strict=True)]
    return Ended(injected, f"{failed}" if failed else "")
