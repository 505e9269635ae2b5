"""Print a hash of every number that estimators, controllers and actuators produce in a set of lock-step runs.

    .venv/bin/python -m benchmarks.fingerprint [--save FILE.npz] [--against FILE.npz] [--only NAME ...]

A change of the code that is meant to leave behaviour alone leaves every hash alone. Save the values with the version
before the change, then compare on the same machine: another processor may round differently.

The hash covers the float64 values of all estimates, plans and applied thrusts in the order of their role and time. It
does not depend on how messages are encoded, on the names of their fields, or on the order in which nodes were stepped.
``--against`` prints for each role the largest difference.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, TypeAlias

import msgspec
import numpy as np

from benchmarks.faults import kinds
from benchmarks.faults import lockstep as fault_runs
from benchmarks.faults.draw import Run
from benchmarks.faults.kinds import Fault, Place
from ltv_mpc.messages import Applied, Estimate, Message, Plan
from services.run.nodes import make_nodes
from services.run.run_config import Override, resolve
from services.tools import lockstep_run

DURATION_S = 40.0
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

FAULTS = (
    *("sensor_off", "sensor_wrong", "sensor_delayed", "message_loss", "message_corruption", "clock_jump"),
    *("solver_failure", "thruster_loss", "second_source", "clock_step", "reference_point", "controller_restart"),
)
"""Classes of faults, one run each."""


class Collector:
    """The numbers of three types of message, in the order of their arrival."""

    def __init__(self) -> None:
        self._rows: dict[str, list[tuple[int, np.ndarray]]] = {"estimate": [], "plan": [], "applied": []}

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


def plain(scenario: str, *settings: str) -> Values:
    """Run a scenario with these settings, for ``DURATION_S`` if they name no other duration."""
    of = resolve(scenario, [Override("fingerprint", [f"run.duration_s={DURATION_S}", "run.seed=5", *settings])])
    collector = Collector()
    lockstep_run.simulate(of, nodes=make_nodes(of), keep=collector.take)
    return collector.values()


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
    descents = {name: lambda s=settings: plain("descent", *s) for name, settings in RUNS.items()}
    faults = {f"fault: {name}": lambda kind=name: faulty(kind) for name in FAULTS}
    return {**descents, "hover": lambda: plain("hover"), **faults}


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
    options = parser.parse_args()
    chosen = {name: make for name, make in runs().items() if not options.only or name.startswith(tuple(options.only))}
    old = {} if options.against is None else dict(np.load(options.against))
    values: Values = {}
    changed = 0
    for name, make in chosen.items():
        made = {f"{name}/{role}": rows for role, rows in make().items()}
        print(f"{name:<34}", *(digest(rows) for rows in made.values()), flush=True)
        for key, said in ((key, difference(rows, old.get(key))) for key, rows in made.items() if old):
            if said:
                changed += 1
                print(f"    {key}: {said}", flush=True)
        values |= made
    if options.save is not None:
        np.savez(options.save, **values)
    whole = hashlib.sha256("".join(map(digest, values.values())).encode()).hexdigest()[:16]
    print(f"fingerprint {whole}" + (f", {changed} of {len(values)} differ" if old else ""))
    return 1 if changed else 0


if __name__ == "__main__":
    sys.exit(main())
