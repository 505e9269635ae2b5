"""Fleet trial on this machine: a router, a plant process, several controller processes, and their processor times."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from pathlib import Path
from typing import Any

import msgspec

from services.bus.options import BusOptions
from services.bus.session import open_session
from services.supervisor.parent_death import die_with_parent
from services.tools.fleet import controllers, plants
from services.tools.fleet.controllers import Controllers
from services.tools.fleet.fleet import Fleet, Wire
from services.tools.fleet.plants import Plants
from sim.evaluation.summary import Quantiles

LEAD_S = 0.5
"""Time from the last "ready" to t = 0."""
READY_S = 600.0
"""Longest wait for a process to be ready; the first start compiles."""
BUSY = 0.9
"""Share of a core from which a process, and of all cores from which the machine, counts as the limit."""
FEW = 0.01
"""Share of missed cycles above which a resource counts as overloaded."""


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """Figures of one trial. Busy: processor time over wall time, 1 is a whole core."""

    vehicles: int
    rate_hz: float
    seconds: float
    controller_processes: int
    plans: int
    missed: int  # estimates without a plan of their own in time: overtaken, or answered after the next was due
    missed_share: float
    latency_ms: Quantiles  # estimate's validity to plan's arrival: median, p99, max
    cycle_ms: Quantiles  # of one controller, with decoding and encoding; the worst process's
    mean_error_m: float
    busy: dict[str, float]  # router, plants, controllers (the busiest process), all
    controller_busy_per_vehicle: float
    plant_busy_per_vehicle: float
    rejected: int
    dropped: int
    limit: str  # what gave way first; "none"


PROGRESS_PERIOD_S = 0.5
"""Time between two reports of progress."""


class TrialFailed(RuntimeError):
    """A process of the fleet ended without its figures."""


def run(fleet: Fleet, processes: int, *, on_progress: Callable[[float], None] = lambda _share: None) -> Row:
    """Start all processes, measure, and stop them. Raises ``TrialFailed``.

    ``on_progress`` receives the elapsed share of the trial.
    """
    processes = min(processes, fleet.vehicles)
    with started_processes() as start:
        way = start("router", _router, fleet.router)
        # One after the other: what the first has compiled the others find.
        children = [
            start(f"controllers {first + 1}", controllers.main, fleet, tuple(range(first, fleet.vehicles, processes)))
            for first in range(processes)
        ]
        world = start("plants", plants.main, fleet)
        start_ns = time.monotonic_ns() + round(LEAD_S * 1e9)
        for child in (*children, world):
            child.send(start_ns)
        measured_ns = start_ns + round(fleet.warm_up_s * 1e9)
        end_ns = measured_ns + round(fleet.seconds * 1e9)

        def report(left_ns: int) -> None:
            on_progress(1.0 - left_ns / (end_ns - start_ns))

        _sleep_until(measured_ns, lambda left_ns: report(left_ns + end_ns - measured_ns))
        before_s = way.cpu_s()
        _sleep_until(end_ns, report)
        routed_s = way.cpu_s() - before_s
        wait_s = 10.0 + fleet.seconds
        return row_of(fleet, [child.receive(wait_s) for child in children], world.receive(wait_s), routed_s)


def row_of(
    fleet: Fleet, reports: list[Controllers], world: Plants, routed_s: float, *, cores: int | None = None
) -> Row:
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
    return Row(
        vehicles=fleet.vehicles,
        rate_hz=fleet.rate_hz,
        seconds=fleet.seconds,
        controller_processes=len(reports),
        plans=world.plans,
        missed=missed,
        missed_share=share,
        latency_ms=world.latency_ms,
        cycle_ms=slowest.cycle_ms,
        mean_error_m=world.mean_error_m,
        busy=busy,
        controller_busy_per_vehicle=thinking / fleet.vehicles,
        plant_busy_per_vehicle=busy["plants"] / fleet.vehicles,
        rejected=sum(one.rejected for one in reports) + world.refused,
        dropped=sum(one.dropped for one in reports) + world.dropped,
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


# --- processes -------------------------------------------------------------------------------------------------------


class _Child:
    """Process of the trial with its pipe."""

    def __init__(self, name: str, process: SpawnProcess, pipe: Connection) -> None:
        self._name, self.process, self._pipe = name, process, pipe

    def send(self, start_ns: int) -> None:
        self._pipe.send(start_ns)

    def receive(self, timeout_s: float) -> Any:
        """Return the next message of the process. Raises ``TrialFailed`` if it has ended or does not answer."""
        try:
            if self._pipe.poll(timeout_s):
                return self._pipe.recv()
        except EOFError:
            self.process.join(5.0)
            raise TrialFailed(f"{self._name} has ended with exit code {self.process.exitcode}") from None
        raise TrialFailed(f"{self._name} has not answered for {timeout_s:.0f} s")

    def cpu_s(self) -> float:
        """Return the processor time so far (s)."""
        try:
            fields = Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()
        except OSError:
            return 0.0
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def stop(self) -> None:
        """Stop the process if it still runs."""
        if self.process.is_alive():
            self.process.terminate()
        self.process.join(5.0)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()
        self._pipe.close()


@contextmanager
def started_processes() -> Iterator[Callable[..., _Child]]:
    """Provide a function that starts a process and waits until it is ready; at the end stop all in reverse order."""
    context = multiprocessing.get_context("spawn")
    children: list[_Child] = []

    def start(name: str, target: Callable[..., None], *args: object) -> _Child:
        ours, theirs = context.Pipe()
        process = context.Process(target=target, args=(*args, theirs, os.getpid()), name=name, daemon=True)
        process.start()
        theirs.close()  # theirs alone: its end is then the pipe's
        children.append(_Child(name, process, ours))
        children[-1].receive(READY_S)
        return children[-1]

    try:
        yield start
    finally:
        for child in reversed(children):
            child.stop()


def _router(endpoint: str, wire: Wire, parent: int) -> None:
    """Run the router process; it is ready when it listens."""
    die_with_parent(parent)
    with open_session(BusOptions(listen=(endpoint,), mode="router"), stop=lambda: False, say=lambda _text: None):
        wire.send("ready")
        with contextlib.suppress(EOFError):
            wire.recv()


def _sleep_until(instant_ns: int, report: Callable[[int], None]) -> None:
    """Sleep until an instant; report the remaining time to ``report`` from time to time."""
    while (left_ns := instant_ns - time.monotonic_ns()) > 0:
        report(left_ns)
        time.sleep(min(left_ns / 1e9, PROGRESS_PERIOD_S))
