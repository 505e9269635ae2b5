"""Any vehicle by its file: a point held in a current, with weights that follow from the vehicle alone.

A start 2 m off the point, at rest in the water, in a direction and with a heading that are drawn; a steady current of
0.2, 0.35 or 0.5 of the top speed ahead, told. Each run lasts until four times the time T of ``control/scaling.py`` and
40 s have passed for settling, and 40 s more, over which it is graded:

    off      largest distance from the point
    settled  when the distance fell below ``NEAR`` of L, or 0.2 m, for good
    sway     rms of the distance from its own mean place: what an oscillation has
    thrust   rms of the change of thrust from cycle to cycle, over its maximum
    failed   plans that are not the QP's

    python -m benchmarks.vehicles [--random 20] [--seeds 4] [--vehicle NAME|FILE ...]
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from benchmarks.loop import Loop, run_config
from ltv_mpc import references
from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.control.controller import Controller
from ltv_mpc.control.resolution import settled
from ltv_mpc.control.scaling import characteristic_scales
from ltv_mpc.messages import Array, Estimate, Plan
from ltv_mpc.vehicle.parameters import Vehicle
from ltv_mpc.vehicle.thruster import revolutions
from services.run.run_config import RunConfig
from sim.water.column import WaterColumn

SHARES = (0.2, 0.35, 0.5)
"""Current over top speed ahead."""
START_M = 2.0
GRADED_S = 40.0
DEEP_M = np.array([0.0, 50.0])


class Held(NamedTuple):
    """Result of one vehicle that holds its point in one current."""

    off_m: float
    settled_s: float
    sway_m: float
    thrust_change: float
    failed: int
    cycles: int
    worst_iterations: int


def drawn(seed: int) -> Vehicle:
    """Draw a vehicle of 30 kg to 3 t with the proportions of a hull of that mass; lengths follow from volume, 2 m at
    200 kg.
    """
    rng = np.random.default_rng(seed)
    rho = 1025.0
    mass = float(np.exp(rng.uniform(np.log(30.0), np.log(3000.0))))
    length = 3.45 * (mass / rho) ** (1.0 / 3.0)
    area = (mass / rho) ** (2.0 / 3.0)
    surge, sway = mass * rng.uniform(1.1, 2.5), mass * rng.uniform(1.5, 2.5)
    drag_surge, drag_sway = (0.5 * rho * area * rng.uniform(*cd) for cd in ((0.4, 3.0), (1.5, 5.0)))
    top = rng.uniform(0.4, 1.5)
    linear = rng.uniform(0.0, 0.5)  # its share of the drag at top speed
    push = drag_surge * top**2 / 2.0
    side = {
        "min_N": -push * rng.uniform(0.3, 1.0),
        "max_N": push,
        "slew_N_per_s": push / rng.uniform(0.2, 1.5),
        "lag_s": rng.uniform(0.05, 0.5) * (mass / 200.0) ** (1.0 / 6.0),
        "propeller_diameter_m": 0.25 * (push / 62.5) ** 0.5,
    }
    side["max_rps"] = 1.03 * revolutions(push, top, rho, side["propeller_diameter_m"])
    arm = length * rng.uniform(0.05, 0.2)
    table = {
        "name": f"random-{seed}",
        "description": f"{mass:.0f} kg",
        "dry_mass_kg": mass,
        "water_density_kgpm3": rho,
        "surge": {
            "mass_kg": surge,
            "linear_damping_kgps": linear * drag_surge * top,
            "quadratic_damping_kgpm": (1.0 - linear) * drag_surge,
        },
        "sway": {
            "mass_kg": sway,
            "linear_damping_kgps": rng.uniform(0.0, 0.2) * drag_sway * top,
            "quadratic_damping_kgpm": drag_sway,
        },
        "yaw": {
            "inertia_kgm2": sway * (rng.uniform(0.22, 0.32) * length) ** 2,
            "linear_damping_Nms": rng.uniform(0.0, 0.1) * drag_sway * length**2 * top,
            "quadratic_damping_kgm2": drag_sway * length**3 / 32.0 * rng.uniform(0.5, 1.5),
        },
        "thruster": {name: {"arm_m": arm, **side} for name in ("port", "starboard")},
    }
    return msgspec.convert(table, Vehicle)


def place(vehicle: Vehicle, share: float, seed: int, settings: tuple[str, ...] = ()) -> RunConfig:
    """Return a target, a current of ``share`` of the vehicle's top speed, and a start 2 m off."""
    rng = np.random.default_rng(seed)
    off, heading, towards = rng.uniform(-np.pi, np.pi, 3)
    scales = characteristic_scales(vehicle)
    base = run_config(
        f"plant.north_m={START_M * np.cos(off)}",
        f"plant.east_m={START_M * np.sin(off)}",
        f"plant.heading_rad={heading}",
        f"run.duration_s={round(4.0 * scales.time_s + 40.0 + GRADED_S)}",
        *settings,
    )
    current = share * scales.speed_mps * np.array([np.cos(towards), np.sin(towards)])
    water = WaterColumn(DEEP_M, np.tile(current, (2, 1)))
    return replace(base, vehicle=vehicle, water=water, reference=references.Point(north_m=0.0, east_m=0.0))


def afloat(estimate: Estimate) -> Estimate:
    """Return the estimate without depth, as at the surface: only the current."""
    return msgspec.structs.replace(estimate, depth_m=None, velocity_down_mps=None)


def hold(vehicle: Vehicle, share: float, seed: int, config: ControllerConfig | None = None) -> Held:
    """Make one run."""
    s = place(vehicle, share, seed)
    plans: list[Plan] = []
    controller = Controller(vehicle, s.reference, config or s.scenario.controller)
    loop = Loop(run_config=s, controller=controller, told=afloat, seen=lambda _estimate, plan: plans.append(plan))
    flown = loop.fly()
    return graded(flown.distance_m, plans, vehicle)


def graded(distance: Array, plans: list[Plan], vehicle: Vehicle) -> Held:
    """Compute the figures of a run, sampled each 10 ms."""
    last = distance[-round(GRADED_S * 100) :]
    near = max(0.2, 0.05 * characteristic_scales(vehicle).length_m)
    outside = np.flatnonzero(distance > near)
    full = np.array([t.max_N for t in vehicle.thrusters[:2]])
    thrust = np.array([plan.thrust_N[0, :2] for plan in plans]) / full
    late = thrust[-round(GRADED_S / 0.3) :]
    return Held(
        off_m=float(last.max()),
        settled_s=0.01 * (outside[-1] + 1 if len(outside) else 0),
        sway_m=float(last.std()),
        thrust_change=float(np.sqrt(np.mean(np.diff(late, axis=0) ** 2))),
        failed=sum(plan.origin.value != "solved" for plan in plans),
        cycles=len(plans),
        worst_iterations=max(plan.solve.iterations for plan in plans),
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--vehicle", nargs="*", default=["paper", "surface", "low-yaw", "weak-reverse"])
    parser.add_argument("--random", type=int, default=0, help="so many drawn vehicles besides")
    parser.add_argument("--first", type=int, default=0, help="seed of the first of them")
    parser.add_argument("--seeds", type=int, default=2, help="starts for each current")
    parser.add_argument("--horizon-s", type=float, help="for all; else the one that `vehicle check` proposes")
    parser.add_argument("--solver", default="osqp")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    vehicles = [Vehicle.load(name) for name in options.vehicle]
    vehicles += [drawn(options.first + i) for i in range(options.random)]
    found = {}
    print(
        f"{'vehicle':<14}{'kg':>6}{'V m/s':>7}{'T s':>6}{'N h s':>7}"
        "   off m at 0.2 0.35 0.5 V    settled s  sway m  change  failed"
    )
    for vehicle in vehicles:
        config = settled(ControllerConfig(horizon_s=options.horizon_s, solver=options.solver), vehicle)
        by_share = {share: [hold(vehicle, share, seed, config) for seed in range(options.seeds)] for share in SHARES}
        every = [run for runs in by_share.values() for run in runs]
        off = "".join(f"{max(run.off_m for run in runs):8.3f}" for runs in by_share.values())
        scales = characteristic_scales(vehicle)
        print(
            f"{vehicle.name:<14}{vehicle.dry_mass_kg:6.0f}{scales.speed_mps:7.2f}{scales.time_s:6.1f}{config.horizon_s:7.1f}"
            f"   {off}"
            f"{max(run.settled_s for run in every):13.1f}{max(run.sway_m for run in every):8.3f}"
            f"{max(run.thrust_change for run in every):8.3f}"
            f"{sum(run.failed for run in every):5d} of {sum(run.cycles for run in every)}",
            flush=True,
        )
        found[vehicle.name] = {str(share): [run._asdict() for run in runs] for share, runs in by_share.items()}
    if options.out is not None:
        options.out.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
