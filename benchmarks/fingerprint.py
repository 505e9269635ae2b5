"""Print a hash of every number that estimators, controllers and actuators produce in a set of lock-step runs.

    .venv/bin/python -m benchmarks.fingerprint [--save FILE.npz] [--against FILE.npz] [--only NAME ...] [--json]

A change of the code that is meant to leave behaviour alone leaves every hash alone. Save the values with the version
before the change, then compare on the same machine: another processor may round differently.

The hash covers the float64 values of all estimates, plans and applied thrusts in the order of their role and time. It
does not depend on how messages are encoded, on the names of their fields, or on the order in which nodes were stepped.
``--against`` prints for each role the largest difference and the time of the first one.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import msgspec
import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.faults import kinds
from benchmarks.faults import lockstep as fault_runs
from benchmarks.faults.draw import Run
from benchmarks.faults.kinds import Fault, Place
from ltv_mpc.control.node import ControllerNode
from ltv_mpc.localisation.estimator import Estimator
from ltv_mpc.messages import (
    Applied,
    ControllerState,
    Estimate,
    EstimatorState,
    Message,
    Plan,
)
from ltv_mpc.node import Inbox, Node, ReceivedMessage
from services.run.nodes import make_nodes
from services.run.run_config import Override, RunConfig, resolve
from services.tools import lockstep_run
from sim.scheduler import LockStep, Observation

S = 1_000_000_000
DURATION_S = 40.0
RESTART_NS = 20 * S
FAULT_S = (20.0, 26.0)
"""Start and end of a fault."""

Values: TypeAlias = dict[str, np.ndarray]
"""Role -> its numbers, message after message in the order of time."""

RUNS: Mapping[str, tuple[str, ...]] = {
    "paper": ("sensors=paper",),
    "realistic, delay, changing water": (
        "sensors=realistic",
        "run.surface_time_s=10",
        "run.compute_delay_s=0.71",
        "water.change_mps_per_rts=0.002",
    ),
    "front": ("sensors=realistic", "water.feature.kind=front", "water.feature.at_s=20"),
    "state known": ("run.perfect_state=true",),
    "state known, current untold": ("run.perfect_state=true", "controller.disturbance.sd_mps=0.1"),
    "limits of the motion": (
        "run.perfect_state=true",
        "controller.limits.max_surge_mps=0.2",
        "controller.limits.max_yaw_rate_radps=0.1",
    ),
    "another vehicle, path and solver": (
        "run.perfect_state=true",
        "vehicle=weak-reverse",
        "reference=square",
        "controller.solver=riccati",
        "controller.max_stages=20",
    ),
}
"""Descents, each with what it sets."""

RESTARTED = "restart"
HOVER = "hover"


class Collector:
    """An observer of lock step that keeps the numbers of three types of message."""

    def __init__(self) -> None:
        self._rows: dict[str, list[tuple[int, np.ndarray]]] = {"estimate": [], "plan": [], "applied": []}

    def published(self, node: str, message: ReceivedMessage) -> None:  # noqa: ARG002
        """Keep the message's numbers."""
        self.take(message.message)

    def take(self, signal: Message) -> None:
        """Keep the numbers of an estimate, a plan or a report of the actuators."""
        match signal:
            case Estimate() as e:
                profile = e.current
                water = (
                    () if profile is None else (profile.depth_m, profile.north_mps, profile.east_mps, profile.sd_mps)
                )
                self._keep("estimate", e.t_ns, [
                    e.north_m, e.east_m, e.heading_rad, e.yaw_rate_radps, e.velocity_north_mps, e.velocity_east_mps,
                    e.depth_m, e.velocity_down_mps, e.covariance, *water,
                ])  # fmt: skip
            case Plan() as p:
                self._keep("plan", p.cycle_t_ns, [p.t_ns, p.thrust_N, p.states])
            case Applied() as a:
                self._keep("applied", a.t_ns, [a.thrust_N, a.command_N])
            case _:
                pass

    def _keep(self, role: str, t_ns: int, values: Iterable[Any]) -> None:
        flat = [np.ravel(np.asarray(np.nan if v is None else v, dtype=np.float64)) for v in values]
        self._rows[role].append((t_ns, np.concatenate([[t_ns * 1e-9], *flat])))

    def values(self) -> Values:
        """Return the kept values by role, in the order of time."""
        ordered = {role: sorted(rows, key=lambda row: row[0]) for role, rows in self._rows.items()}
        return {
            role: np.concatenate([row for _, row in rows]) if rows else np.empty(0) for role, rows in ordered.items()
        }


class Restarted:
    """A node that is replaced by a new one at ``RESTART_NS``, which is given what a supervisor would hand it."""

    def __init__(self, make: Callable[[], Node], memory: dict[type[Message], Message]) -> None:
        self._make, self._memory = make, memory
        self._node = make()
        self._restarted = False
        self.name, self.schedule = self._node.name, self._node.schedule
        self.reads, self.writes = self._node.reads, self._node.writes

    def step(self, t_ns: int, inbox: Inbox) -> Sequence[Message]:
        """Step the node; at the time of the restart, step a new one that begins from the newest saved state."""
        if not self._restarted and t_ns >= RESTART_NS:
            self._restarted, self._node = True, self._make()
            inbox = [ReceivedMessage(self._state(), 1, 0, t_ns), *inbox]
        out = self._node.step(t_ns, inbox)
        self._memory.update({type(signal): signal for signal in out})
        return out

    def _state(self) -> Message:
        newest: Any = self._memory.get
        if self.name == ControllerNode.name:
            return msgspec.structs.replace(newest(ControllerState), plan=newest(Plan), estimate=newest(Estimate))
        return msgspec.structs.replace(newest(EstimatorState), estimate=newest(Estimate))


def run_config(name: str, *settings: str) -> RunConfig:
    """Resolve the scenario ``name`` with these settings, for ``DURATION_S`` if they name no other duration."""
    return resolve(name, [Override("fingerprint", [f"run.duration_s={DURATION_S}", "run.seed=5", *settings])])


def lockstep(of: RunConfig, nodes: list[Node]) -> Values:
    """Run these nodes of the situation."""
    collector = Collector()
    delay_ns = round(of.scenario.run.compute_delay_s * 1e9)
    LockStep(
        nodes,
        start_ns=of.scenario.start_ns,
        compute_delay_ns=delay_ns,
        observation=Observation(collector),
        latest=lockstep_run.LATEST,
        make_rejection=lockstep_run.rejected_message,
    ).advance(of.scenario.end_ns)
    return collector.values()


def restarted() -> Values:
    """Run a descent whose estimator and controller are replaced in the middle."""
    of = run_config("descent")
    memory: dict[type[Message], Message] = {}

    def again(node: Node) -> Node:
        def make() -> Node:
            return next(new for new in make_nodes(of) if new.name == node.name)

        return Restarted(make, memory) if node.name in (ControllerNode.name, Estimator.name) else node

    return lockstep(of, [again(node) for node in make_nodes(of)])


def faulty(kind: str) -> Values:
    """Run with one fault of this class, its first target and the middle of its sizes."""
    row = kinds.of(kind, Place.LOCKSTEP)
    start_s, end_s = FAULT_S
    fault = Fault(kind=kind, target=row.targets[0], start_s=start_s, end_s=end_s, size=sum(row.size) / 2, seed=1)
    if kind == "clock_jump":
        fault = msgspec.structs.replace(fault, size=60.0)
    collector = Collector()
    fault_runs.observe(Run(seed=5, faults=(fault,), duration_s=DURATION_S, afloat_s=3.0), tap=collector.take)
    return collector.values()


def runs() -> dict[str, Callable[[], Values]]:
    """Every run by its name."""
    descents = {name: lambda s=settings: _plain("descent", *s) for name, settings in RUNS.items()}
    faults = {f"fault: {row.name}": lambda k=row.name: faulty(k) for row in kinds.KINDS if row.place is Place.LOCKSTEP}
    return {**descents, HOVER: lambda: _plain("hover"), RESTARTED: restarted, **faults}


def _plain(scenario: str, *settings: str) -> Values:
    of = run_config(scenario, *settings)
    return lockstep(of, make_nodes(of))


def digest(values: np.ndarray) -> str:
    """Return the first 16 hexadecimal digits of the SHA-256 of the values' bytes."""
    return hashlib.sha256(np.ascontiguousarray(values, dtype="<f8").tobytes()).hexdigest()[:16]


def difference(new: np.ndarray, old: np.ndarray | None) -> str:
    """Say how far two rows of numbers are apart: empty where they are the same to the bit."""
    if old is None:
        return "not in the other"
    if new.tobytes() == old.tobytes():
        return ""
    if new.shape != old.shape:
        return f"{len(old)} -> {len(new)} numbers"
    apart = np.abs(np.nan_to_num(new) - np.nan_to_num(old))
    return f"largest difference {apart.max():.3g}, {100.0 * np.mean(apart > 0):.1f} % of the numbers differ"


def main() -> int:
    """Make the runs; exit 1 where ``--against`` finds a difference."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--save", type=Path, help="write all values to this .npz file")
    parser.add_argument("--against", type=Path, help="compare with the values in this .npz file")
    parser.add_argument("--only", nargs="*", help="only the runs whose names begin with one of these")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    chosen = {name: make for name, make in runs().items() if not options.only or name.startswith(tuple(options.only))}
    old = {} if options.against is None else dict(np.load(options.against))
    values = {f"{name}/{role}": rows for name, make in chosen.items() for role, rows in make().items()}
    if options.save is not None:
        np.savez(options.save, **values)
    hashes = {key: digest(rows) for key, rows in values.items()}
    whole = hashlib.sha256("".join(hashes.values()).encode()).hexdigest()[:16]
    changed = {key: said for key, rows in values.items() if (said := difference(rows, old.get(key)))} if old else {}
    if options.json:
        json.dump({"fingerprint": whole, "hashes": hashes, "changed": changed}, sys.stdout)
        return 1 if changed else 0
    table = Table("run", "estimate", "plan", "applied")
    for name in chosen:
        table.add_row(name, *(hashes[f"{name}/{role}"] for role in ("estimate", "plan", "applied")))
    console = Console()
    console.print(table)
    for key, said in changed.items():
        console.print(f"{key}: {said}")
    console.print(f"fingerprint {whole}" + (f", {len(changed)} of {len(values)} differ" if old else ""))
    return 1 if changed else 0


if __name__ == "__main__":
    sys.exit(main())
