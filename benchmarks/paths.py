"""Tracking error on each shipped path, in still water and in a current.

    .venv/bin/python -m benchmarks.paths [NAME ...] [--vehicle NAME|FILE] [--current MPS] [--horizon-s S]

The nominal model, state and current known, the current the same at all depths, from rest at north = east = 0, heading
north. "off" is the distance from the path as it is driven, corners rounded, from the first point on; "target" that from
the target.
"""

from __future__ import annotations

import argparse
import math
from typing import NamedTuple

import msgspec
import numpy as np

from ltv_mpc import Controller, ControllerConfig, CurrentProfile, Estimate, Vehicle, references
from ltv_mpc.control.nominal_model import as_estimate
from ltv_mpc.control.prediction import Prediction
from ltv_mpc.control.sent_commands import SentCommands

NAMES = ("line", "square", "lawnmower", "circle", "spiral")
PERIOD_NS = 300_000_000
LONGEST_S = 3600.0


class Outcome(NamedTuple):
    """Result of one path: distances (m), time from first to last point (s), share of cycles that were solved."""

    off_mean: float
    off_max: float
    target_mean: float
    seconds: float
    solved: float


def follow(name: str, vehicle: Vehicle, toward: tuple[float, float], horizon_s: float | None) -> Outcome:
    """One path in a current (m/s, north and east)."""
    controller = Controller(vehicle, references.load(name), ControllerConfig(horizon_s=horizon_s))
    deep = np.array([0.0, 100.0])
    water = CurrentProfile(depth_m=deep, north_mps=np.full(2, toward[0]), east_mps=np.full(2, toward[1]))
    plant, commands = Prediction(vehicle), SentCommands(vehicle)  # its thrusters lag behind all commands so far
    estimate = msgspec.structs.replace(Estimate.at_rest(depth_m=0.0), current=water)
    off, target, solved, begun_s, end_s = [], [], [], math.nan, math.nan
    while estimate.t_ns < LONGEST_S * 1e9 and math.isnan(end_s):
        plan = controller.plan(estimate)
        solved.append(plan.origin == "solved")
        t_s = float(plan.t_ns[0]) * 1e-9
        if plan.progress is not None and plan.cross_track_m is not None and plan.reference_m is not None:
            if plan.progress > 0.0:
                begun_s = t_s if math.isnan(begun_s) else begun_s
                off.append(abs(plan.cross_track_m))
                target.append(math.dist(plan.states[0, :2], plan.reference_m))
            end_s = t_s if plan.progress >= 1.0 else end_s
        commands.add(plan)
        estimate = as_estimate(plant.state_at(estimate, estimate.t_ns + PERIOD_NS, commands), estimate)
    return Outcome(
        float(np.mean(off)), float(np.max(off)), float(np.mean(target)), end_s - begun_s, float(np.mean(solved))
    )


def main() -> None:
    """Every path in still water and in a current northwards and eastwards."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", default=NAMES)
    parser.add_argument("--vehicle", default="paper")
    parser.add_argument("--current", type=float, default=0.2)
    parser.add_argument("--horizon-s", type=float, help="default: the one that suits the vehicle")
    asked = parser.parse_args()
    vehicle = Vehicle.load(asked.vehicle)
    print("| path | current | off, mean | off, max | from the target, mean | time | solved |")
    print("|---|---|---|---|---|---|---|")
    for name in asked.names:
        for words, toward in (("none", (0.0, 0.0)), ("north", (asked.current, 0.0)), ("east", (0.0, asked.current))):
            done = follow(name, vehicle, toward, asked.horizon_s)
            print(
                f"| `{name}` | {words} | {done.off_mean:.3f} m | {done.off_max:.2f} m | {done.target_mean:.3f} m "
                f"| {done.seconds:.0f} s | {done.solved:.1%} |",
                flush=True,
            )
        for note in references.load(name).notes(vehicle):
            print(f"<!-- {name}: {note} -->")


if __name__ == "__main__":
    main()
