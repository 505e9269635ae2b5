"""Run of processes with an injector: two routers, with the controller alone at the second one.

    plant, sensors, estimator, recorder -- router A -- inject -- router B -- controller

All messages of the controller pass the injector. The recording at A holds what the controller received, except for
messages that were harmed on their way to B.
"""

from __future__ import annotations

import json
import os
import secrets
import subprocess
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import msgspec

from ltv_mpc.messages import Injection, MessageFault
from services.bus.options import BusOptions
from services.run import folder as run_folder
from services.run.run_config import Override, RunConfig, resolve
from services.supervisor import entry_point, loopback, process_table
from services.tools.faults import inject
from services.tools.faults.draw import Run
from services.tools.faults.fault import Fault
from services.tools.faults.subprocess_tools import Process, Started, end

UNDER_TEST = "controller"
ROUTER_S = 20.0
STOP_S = 10.0

IN_ORDER = ("plant", "sensors", "estimator", UNDER_TEST, "inject", "recorder", "router", "router-b")
"""Order in which processes are stopped: the recorder receives the last messages of all others."""


class Account(NamedTuple):
    """End of a run: exit codes by process (None: it was killed), messages harmed by each fault, last log lines."""

    codes: dict[str, int | None]
    harmed: list[int]
    output: str


def injection(fault: Fault) -> Injection:
    """Convert a fault of the campaign to the injector's message."""
    return Injection(
        key=fault.target,
        fault=MessageFault(fault.kind.removeprefix("message_")),
        start_t_ns=round(fault.start_s * 1e9),
        end_t_ns=round(fault.end_s * 1e9),
        size=fault.size,
        seed=fault.seed,
    )


def run_config(run: Run, *, speed: float) -> RunConfig:
    """Resolve the scenario of the run. Raises ``ConfigError``."""
    settings = (
        f"run.seed={run.seed}",
        f"run.duration_s={run.duration_s}",
        f"run.surface_time_s={run.afloat_s}",
        f"run.speed={speed}",
    )
    return resolve("hover", [Override("campaign", settings)])


def run(of: RunConfig, faults: Sequence[Fault], folder: Path, *, patience_s: float) -> Account:
    """Make the run in ``folder``, for at most ``patience_s`` of wall time; then stop every process."""
    made = run_folder.make("hover", of.files, out=folder, force=False)
    logs = made.path / "logs"
    logs.mkdir()
    namespace = f"auv/{secrets.token_hex(4)}"
    a, b = (
        process_table.RunContext(folder=made, router=f"tcp/127.0.0.1:{loopback.free_port()}", namespace=namespace)
        for _ in range(2)
    )
    modules = {row.name: row.module for row in process_table.processes(of.scenario)}
    running: dict[str, Process] = {}
    with Started() as started:

        def start(name: str, module: str, config: msgspec.Struct) -> None:
            file = logs / f"{name}.json"
            entry_point.write_config(file, config)
            words = [entry_point.__name__, str(os.getpid()), module, str(file)]
            running[name] = started.start(words, logs / f"{name}.log", results=True)

        for name, place in (("router", a), ("router-b", b)):
            start(name, modules["router"], process_table.config_of("router", of, place))
            _await(place.router)
        at_a, at_b = (
            BusOptions(connect=(place.router,), mode="client", namespace=namespace, role=inject.NAME)
            for place in (a, b)
        )
        injections = tuple(injection(fault) for fault in faults)
        start(
            "inject",
            inject.__name__,
            inject.Config(node=UNDER_TEST, injections=injections, at_a=at_a, at_b=at_b),
        )
        for name in ("recorder", "plant", "sensors", "estimator", UNDER_TEST):
            start(name, modules[name], process_table.config_of(name, of, b if name == UNDER_TEST else a))
        with suppress(subprocess.TimeoutExpired):
            running["plant"].wait(patience_s)
        codes = {name: end(running[name], STOP_S) for name in IN_ORDER}
    return Account(codes, _harmed(logs / "inject.log"), _last(logs))


def _await(place: str) -> None:
    until = time.monotonic() + ROUTER_S
    while not loopback.is_listening(place) and time.monotonic() < until:
        time.sleep(0.02)


def _harmed(log: Path) -> list[int]:
    """Read the number of harmed messages by fault from the last line of the injector's log."""
    lines = log.read_text(errors="replace").splitlines() if log.exists() else []
    try:
        return [int(entry["harmed"]) for entry in json.loads(lines[-1])]
    except (IndexError, ValueError, TypeError, KeyError, msgspec.MsgspecError):
        return []


def _last(logs: Path) -> str:
    """Return the last log line of each process."""
    last = {}
    for log in sorted(logs.glob("*.log")):
        lines = log.read_text(errors="replace").splitlines()
        last[log.stem] = lines[-1][-200:] if lines else ""
    return "; ".join(f"{name}: {line}" for name, line in last.items())
