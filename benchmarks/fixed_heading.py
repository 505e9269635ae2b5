"""Fixed heading at a point in a current: how far bow and position are off, by direction and speed of the current.

    .venv/bin/python -m benchmarks.fixed_heading [--vehicle NAME]

The vehicle begins at rest on the point, with the wanted heading north, in a current that it knows, and moves as the
model predicts. What counts are mean and largest values after ``SETTLING_S``: bow and position swing.
"""

from __future__ import annotations

import argparse
import math
from typing import NamedTuple

import msgspec
import numpy as np

from ltv_mpc import Controller, CurrentProfile, Estimate, Vehicle, advance
from ltv_mpc.messages import SolveStatus
from ltv_mpc.references import Point

DIRECTIONS_DEG = tuple(range(0, 360, 45))
"""Directions that the current comes from, clockwise from the heading."""

SPEEDS_MPS = (0.1, 0.2)

SETTLING_S, COUNTED_S, CYCLE_S = 60.0, 60.0, 0.3


class Held(NamedTuple):
    """Deviations at the point, after settling."""

    mean_bow_deg: float  # from the wanted heading, positive to starboard
    bow_deg: float  # largest
    position_m: float  # largest
    unsolved: int


def held(vehicle: Vehicle, from_deg: float, speed_mps: float) -> Held:
    """Return how a vehicle holds the heading north in a current.

    Parameters
    ----------
    vehicle : model of the controller and of the motion.
    from_deg : direction that the current comes from (degrees, clockwise from north).
    speed_mps : speed of the current (m/s).
    """
    angle = math.radians(from_deg)
    north, east = -speed_mps * math.cos(angle), -speed_mps * math.sin(angle)
    water = CurrentProfile(depth_m=np.zeros(1), north_mps=np.array([north]), east_mps=np.array([east]))
    controller = Controller(vehicle, Point(north_m=0.0, east_m=0.0, heading_deg=0.0))
    estimate = msgspec.structs.replace(Estimate.at_rest(), current=water)
    bow, position, unsolved = [], [], 0
    for _ in range(round((SETTLING_S + COUNTED_S) / CYCLE_S)):
        plan = controller.plan(estimate)
        unsolved += plan.solve.status is not SolveStatus.SOLVED
        estimate = advance(vehicle, estimate, plan, duration_s=CYCLE_S)
        bow.append(math.degrees(math.remainder(estimate.heading_rad, math.tau)))
        position.append(math.hypot(estimate.north_m, estimate.east_m))
    settled = round(SETTLING_S / CYCLE_S)
    swing = np.array(bow[settled:])
    return Held(float(swing.mean()), float(np.abs(swing).max()), max(position[settled:]), unsolved)


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--vehicle", default="paper", metavar="NAME", help="shipped name or file of the vehicle")
    vehicle = Vehicle.load(parser.parse_args().vehicle)
    columns = "bow: mean, largest (deg) | {0:g} m/s: position, largest (m)"
    print(f"| current from (deg) | {' | '.join(f'{speed:g} m/s, {columns.format(speed)}' for speed in SPEEDS_MPS)} |")
    print(f"|---|{'---|' * 2 * len(SPEEDS_MPS)}")
    unsolved = 0
    for from_deg in DIRECTIONS_DEG:
        results = [held(vehicle, from_deg, speed) for speed in SPEEDS_MPS]
        unsolved += sum(result.unsolved for result in results)
        cells = (f"{round(r.mean_bow_deg)}, {r.bow_deg:.0f} | {r.position_m:.2f}" for r in results)
        print(f"| {from_deg} | {' | '.join(cells)} |", flush=True)
    print(f"\ncycles not solved: {unsolved}")


if __name__ == "__main__":
    main()
