"""Fleet trial on this machine: a router, a plant process, several controller processes, and their processor times."""

from __future__ import annotations

import os
import select
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import msgspec

from benchmarks.fleet import controllers, plants
from benchmarks.fleet.controllers import Controllers
from benchmarks.fleet.fleet import Fleet
from benchmarks.fleet.plants import Plants
from benchmarks.processes import Process, Started, await_router

LEAD_S = 0.5
"""Time from the last "ready" to t = 0."""
READY_S = 600.0
"""Longest wait for a process to be ready; the first start compiles."""
BUSY = 0.9
"""Share of a core from which a process, and of all cores from which the machine, counts as the limit."""
FEW = 0.01
"""Share of missed cycles above which a resource counts as overloaded."""


PROGRESS_PERIOD_S = 0.5
"""Time between two reports of progress."""


class TrialFailed(RuntimeError):
    """A process of the fleet ended without its figures."""


def run(fleet: Fleet, *, on_progress: Callable[[float], None] = lambda _share: None) -> SimpleNamespace:
    """Start all processes, measure, and stop them. Raises ``TrialFailed``.

    ``on_progress`` receives the elapsed share of the trial.
    """
    processes = min(fleet.processes, fleet.vehicles)
    settings = msgspec.json.encode(msgspec.structs.replace(fleet, processes=processes)).decode()
    with Started() as started:
        router = started.start("services.cli", "router", "--listen", fleet.router)
        await_router(fleet.router)
        # One after the other: what the first has compiled the others find.
        children = [start(started, controllers.__name__, settings, str(first)) for first in range(processes)]
        children.append(start(started, plants.__name__, settings))
        start_ns = time.monotonic_ns() + round(LEAD_S * 1e9)
        for child in children:
            assert child.stdin is not None
            child.stdin.write(b"%d\n" % start_ns)
            child.stdin.flush()
        begin_ns, end_ns = fleet.measured_ns
        busy_s = [0.0, 0.0]
        for i, at_ns in enumerate((begin_ns, end_ns)):
            while (left_ns := start_ns + at_ns - time.monotonic_ns()) > 0:
                on_progress(1.0 - (left_ns + end_ns - at_ns) / end_ns)
                time.sleep(min(left_ns / 1e9, PROGRESS_PERIOD_S))
            busy_s[i] = processor_s(router)
        *answers, world = [receive(child, 10.0 + fleet.seconds) for child in children]
        reports = [msgspec.json.decode(answer, type=Controllers) for answer in answers]
        return row_of(fleet, reports, msgspec.json.decode(world, type=Plants), busy_s[1] - busy_s[0])


def start(started: Started, module: str, *words: str) -> Process:
    """Start a process of the fleet and wait until it is ready. Raises ``TrialFailed``."""
    child = started.start(module, *words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=None)
    receive(child, READY_S)
    return child


def receive(child: Process, within_s: float) -> bytes:
    """Return the next line of a process. Raises ``TrialFailed`` if it has ended or does not answer."""
    assert child.stdout is not None
    line = child.stdout.readline() if select.select([child.stdout], [], [], within_s)[0] else None
    if line:
        return line
    _, _, name, *_ = child.args  # type: ignore[misc]
    what = f"not answered for {within_s:.0f} s" if line is None else f"ended with exit code {child.wait()}"
    raise TrialFailed(f"{name} has {what}")


def processor_s(process: Process) -> float:
    """Return the processor time of a process so far (s)."""
    user, system = Path(f"/proc/{process.pid}/stat").read_text(errors="replace").rpartition(")")[2].split()[11:13]
    return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")


def row_of(
    fleet: Fleet, reports: list[Controllers], world: Plants, routed_s: float, *, cores: int | None = None
) -> SimpleNamespace:
    """Return the result of a trial. ``cores``: of the machine; None: of this one."""
    busy = {
        "router": routed_s / fleet.seconds,
        "plants": world.cpu_s / fleet.seconds,
        "controllers": max(one.cpu_s for one in reports) / fleet.seconds,
    }
    thinking = sum(one.cpu_s for one in reports) / fleet.seconds
    busy["all"] = busy["router"] + busy["plants"] + thinking
    missed = max(world.estimates - world.plans, 0) + world.late
    share = missed / max(world.estimates, 1)
    slowest = max(reports, key=lambda one: one.cycle_ms.p99 or 0.0)
    return SimpleNamespace(
        vehicles=fleet.vehicles,
        rate_hz=fleet.rate_hz,
        seconds=fleet.seconds,
        controller_processes=len(reports),
        plans=world.plans,
        missed=missed,  # estimates without a plan of their own in time: overtaken, or answered after the next was due
        missed_share=share,
        latency_ms=world.latency_ms,  # estimate's validity to plan's arrival: median, p99, max
        cycle_ms=slowest.cycle_ms,  # of one controller, with decoding and encoding; the worst process's
        mean_error_m=world.mean_error_m,
        busy=busy,  # processor time over wall time, 1 is a whole core
        controller_busy_per_vehicle=thinking / fleet.vehicles,
        plant_busy_per_vehicle=busy["plants"] / fleet.vehicles,
        rejected=sum(one.rejected for one in reports) + world.refused,
        limit=_limit(busy, share, cores or os.cpu_count() or 1),
    )


def _limit(busy: dict[str, float], missed_share: float, cores: int) -> str:
    """Return the resource that limits the fleet, a saturated process or the machine; "none" if deadlines are met."""
    if missed_share <= FEW:
        return "none"
    full = [name for name in ("controllers", "plants", "router") if busy[name] >= BUSY]
    if full:
        return max(full, key=lambda name: busy[name])
    return "all cores" if busy["all"] >= BUSY * cores else "no full processor"
