"""Fault injection in processes: a run of ``ltv-mpc sim`` whose processes are attacked.

Runs go at twice real time. This process attacks the run's processes when the run's clock reaches the time of a fault.
The run receives no notice of it.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

import msgspec

from ltv_mpc.messages import Clock, ClockState
from services.bus.options import BusOptions
from services.bus.roles import DISPLAY
from services.bus.session import open_session
from services.bus.topics import BY_TYPE, Topic
from services.bus.wire import WireError, decode
from services.processes import plant
from services.runtime.clock import ClockError, VehicleClock, monotonic_us
from services.supervisor.entry_point import read_config
from services.tools.faults import attacks
from services.tools.faults.draw import Run
from services.tools.faults.fault import Fault
from services.tools.faults.lockstep_runs import SCENARIO
from services.tools.faults.subprocess_tools import Process, Started

SPEED = 2.0
"""Vehicle seconds per wall second."""

START_S = 90.0
"""Longest wait for the start of a run, on a machine with other load."""

POLL_S = 0.02
"""Time between two looks at the run's clock and process (s)."""

END_S = 30.0
"""Longest wall time from a run's end to the exit of its processes."""

LAST_LINES, MAX_TEXT = 4, 500
"""Number of last log lines in a result, and the largest length of their text (characters)."""


class Injected(NamedTuple):
    """Injected fault of a run of processes."""

    fault: Fault
    at_us: int  # host's monotonic clock; for a full disk: when space was free again
    at_ns: int  # vehicle time
    why: str = ""  # reason if the fault was not injected


class Ended(NamedTuple):
    """Result of a run of processes: folder, exit code, last log lines, and the injected faults."""

    folder: Path
    code: int | None  # None: the run did not end in time and was ended
    output: str
    injected: list[Injected]


class _Time:
    """Vehicle time of the run, from its clock messages."""

    def __init__(self) -> None:
        self._clock = VehicleClock()
        self.state = ClockState.WAITING

    def offer(self, topic: Topic | None, key: str, payload: bytes) -> None:  # noqa: ARG002  (there is one key)
        """Update the clock (called on the bus's thread)."""
        try:
            clock, _ = decode(Clock, payload)
            self._clock.follow(clock)
            self.state = clock.state
        except (WireError, ClockError):
            return

    def now_ns(self) -> int | None:
        """Return the vehicle time (ns); None before the run has a clock."""
        return self._clock.read(monotonic_us()) if self.state is not ClockState.WAITING else None


def arguments(run: Run, folder: Path) -> list[str]:
    """Return the command line of the simulation."""
    return [
        "services.cli",
        *("sim", SCENARIO, "--out", str(folder), "--json"),
        *("--speed", repr(SPEED), "--duration-s", repr(run.duration_s), "--surface-time-s", repr(run.afloat_s)),
        *("--set", f"run.seed={run.seed}"),
    ]


def supervised(run: Run, folder: Path) -> Ended:
    """Run ``ltv-mpc sim`` with its supervisor while its processes are killed, stopped, slowed or refused disk space."""
    log = folder.with_suffix(".log")
    with Started() as started:
        process = started.start(arguments(run, folder), log, results=False)
        injected = _attack(run.faults, process, folder)
        code = _end_of(process, run)
    return Ended(folder, code, _last_output(log), injected)


def _last_output(log: Path) -> str:
    """Return the last log lines, without the lines of progress."""
    lines = log.read_text(errors="replace").splitlines()
    kept = [line.strip() for line in lines if line.strip() and not line.startswith(("t ", "report: ", str(log.parent)))]
    return "; ".join(kept[-LAST_LINES:])[-MAX_TEXT:]


def _end_of(process: Process, run: Run) -> int | None:
    """Return the exit code; None if the run did not end in time."""
    until = time.monotonic() + (run.duration_s + run.afloat_s) * 2.0 / SPEED + START_S + END_S
    while time.monotonic() < until:
        if (code := process.poll()) is not None:
            return code
        time.sleep(0.1)
    return None


def _attack(faults: Sequence[Fault], process: Process, folder: Path) -> list[Injected]:
    """Inject the faults one after another; return those that were due before the run ended."""
    injected: list[Injected] = []
    with ExitStack() as sessions:
        if (clock := _clock_of(process, folder, sessions)) is None:
            return injected
        for fault in faults:
            start_ns, end_ns = round(fault.start_s * 1e9), round(fault.end_s * 1e9)
            while process.poll() is None and (clock.now_ns() or start_ns - 1) < start_ns:
                time.sleep(POLL_S)
            if process.poll() is not None:
                break
            at_us, at_ns, why = monotonic_us(), clock.now_ns() or start_ns, ""
            try:
                pid = attacks.pid_of(fault.target, process.pid)
                attacks.attack(fault, pid, lasts=lambda end_ns=end_ns: (clock.now_ns() or end_ns) < end_ns)  # type: ignore[misc]
            except (attacks.NotFound, ProcessLookupError) as error:
                why = str(error)
            if fault.kind == "disk_full":  # no process can write before space is free again
                at_us = monotonic_us()
            injected.append(Injected(fault, at_us, at_ns, why))
    return injected


def _clock_of(process: Process, folder: Path, sessions: ExitStack) -> _Time | None:
    """Return the clock of a run, found by the router address in the run's settings; None: the run never started."""
    until = time.monotonic() + START_S
    clock, connected = _Time(), False
    while process.poll() is None and time.monotonic() < until:
        if not connected and (options := _bus_of(folder)) is not None:
            session = sessions.enter_context(open_session(options, stop=lambda: False, say=lambda _: None))
            session.subscribe(BY_TYPE[Clock].key, BY_TYPE[Clock], clock)
            connected = True
        if clock.now_ns() is not None:
            return clock
        time.sleep(POLL_S)
    return None


def _bus_of(folder: Path) -> BusOptions | None:
    """Return the bus options of the run in ``folder`` once its plant has been started."""
    try:
        config: plant.Config = read_config(folder / "logs" / "plant.json", plant.Config)
    except (OSError, msgspec.DecodeError):  # not there yet, or not all of it
        return None
    return msgspec.structs.replace(config.bus, role=DISPLAY)
