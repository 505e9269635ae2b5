"""Bow first along a path: time astern, cross-track error and thrust, with the bow first and with either end.

    .venv/bin/python -m benchmarks.bow_first [--vehicles NAME ...]

Each vehicle follows a square of 20 m at half its top speed. It begins at rest on the first corner, with its bow or its
stern to the path, in still water and in a current of a third of its top speed that it knows, and moves as the model
predicts. ``foreign`` is the craft of tests/foreign_plant, with a current that the controller does not know. The time
astern counts after the time of a turn by 180 degrees.
"""

from __future__ import annotations

import argparse
import math
from typing import NamedTuple, get_args

import msgspec
import numpy as np

from ltv_mpc.control.config import Bow, ControllerConfig, MotionLimits
from ltv_mpc.control.controller import Controller
from ltv_mpc.control.nominal_model import advance
from ltv_mpc.messages import CurrentProfile, Estimate, Plan, SolveStatus
from ltv_mpc.references import Place, Waypoints
from ltv_mpc.vehicle.parameters import Vehicle
from ltv_mpc.vehicle.performance import performance
from tests.foreign_plant.flight import HULL, SQUARE, Flight

VEHICLES = ("paper", "low-yaw", "surface", "weak-reverse", "foreign")

CORNERS = ((0.0, 0.0), (0.0, 20.0), (-20.0, 20.0), (-20.0, 0.0))

ASTERN_SHARE = 0.02
"""Surge astern over the top speed above which the vehicle goes astern."""

CYCLE_S = 0.3


class Flown(NamedTuple):
    """Figures of one lap."""

    astern: float  # share of the time
    cross_track_m: float  # 95 % of its magnitude
    mean_abs_N: float
    lap_s: float  # infinite if it was not completed
    unsolved: int
    cycles: int


def known(
    vehicle: Vehicle, config: ControllerConfig, *, stern: bool, current_mps: float
) -> tuple[list[float], list[Plan]]:
    """Fly a vehicle in a current that it knows; return the surge (m/s) and the plan of each cycle."""
    top = performance(vehicle).top_speed_ahead_mps or 0.0
    places = tuple(Place(north_m=north, east_m=east) for north, east in CORNERS)
    square = Waypoints(waypoints=places, closed=True, speed_mps=0.5 * top, corner_m=0.5)
    controller = Controller(vehicle, square, config)
    water = current_mps * np.array([0.6, -0.8])
    at, north, east = np.array([0.0, 1.0]), np.full(2, water[0]), np.full(2, water[1])
    estimate = msgspec.structs.replace(
        Estimate.at_rest(heading_rad=-0.5 * math.pi if stern else 0.5 * math.pi),
        velocity_north_mps=float(water[0]),
        velocity_east_mps=float(water[1]),
        current=CurrentProfile(depth_m=at, north_mps=north, east_mps=east),
    )
    surge, plans = [], []
    while len(plans) * CYCLE_S < 3.0 * 80.0 / (0.5 * top) and not (plans and (plans[-1].progress or 0.0) >= 0.999):
        plans.append(controller.plan(estimate))
        surge.append(float(plans[-1].states[0, 2]))
        estimate = advance(vehicle, estimate, plans[-1], duration_s=CYCLE_S)
    return surge, plans


def foreign(config: ControllerConfig, *, stern: bool) -> tuple[list[float], list[Plan]]:
    """Fly the foreign craft as ``known`` does."""
    flight = Flight(config=config, heading_rad=-0.5 * math.pi if stern else 0.5 * math.pi)
    flight.command(action="arm")
    flight.command(action="follow", reference_toml=SQUARE.read_text())
    surge: list[float] = []
    while len(surge) * CYCLE_S < 200.0 and not (flight.plans and (flight.plans[-1].progress or 0.0) >= 0.999):
        flight.fly(CYCLE_S)
        surge.append(flight.hull.x[7])
    return surge, flight.plans


def lap(name: str, bow: Bow, *, stern: bool, current_share: float) -> Flown:
    """Fly one lap."""
    config = ControllerConfig(limits=MotionLimits(bow=bow))
    vehicle = Vehicle.load(str(HULL) if name == "foreign" else name)
    can = performance(vehicle)
    top = can.top_speed_ahead_mps or 0.0
    if name == "foreign":
        surge, plans = foreign(config, stern=stern)
    else:
        surge, plans = known(vehicle, config, stern=stern, current_mps=current_share * top)
    after = round(2.0 * (can.turn_90deg_s or 0.0) / CYCLE_S)
    cross = [abs(plan.cross_track_m or 0.0) for plan in plans]
    return Flown(
        float(np.mean(np.array(surge[after:]) < -ASTERN_SHARE * top)),
        float(np.quantile(cross, 0.95)),
        float(np.mean([np.abs(plan.thrust_N[0, :2]).mean() for plan in plans])),
        CYCLE_S * len(plans) if (plans[-1].progress or 0.0) >= 0.999 else math.inf,
        sum(plan.solve.status is not SolveStatus.SOLVED for plan in plans),
        len(plans),
    )


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--vehicles", nargs="+", default=VEHICLES, choices=VEHICLES)
    options = parser.parse_args()
    columns = (
        "vehicle, current",
        "begins with",
        "bow",
        "time astern",
        "cross track, 95 % (m)",
        "mean abs F (N)",
        "lap (s)",
    )
    print(f"| {' | '.join((*columns, 'unsolved'))} |")
    print("|---|---|---|---|---|---|---|---|")
    for name in options.vehicles:
        for share in (1 / 3,) if name == "foreign" else (0.0, 1 / 3):
            for stern in (False, True):
                for bow in get_args(Bow):
                    f = lap(name, bow, stern=stern, current_share=share)
                    cells = (
                        f"{name}, {'unknown' if name == 'foreign' else f'{share:.2f}'}",
                        "stern" if stern else "bow",
                        bow,
                        *(f"{f.astern:.2f}", f"{f.cross_track_m:.2f}", f"{f.mean_abs_N:.1f}", f"{f.lap_s:.0f}"),
                        f"{f.unsolved} of {f.cycles}",
                    )
                    print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
