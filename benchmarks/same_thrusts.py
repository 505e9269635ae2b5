"""Compare the thrusts of 2,000 control cycles of all kinds with those of another version of the controller.

    .venv/bin/python -m benchmarks.same_thrusts --save FILE.npz       with the version before the change
    .venv/bin/python -m benchmarks.same_thrusts --against FILE.npz    with the version after it

Each case is a short closed loop along the nominal model, with drawn vehicle, solver, horizon, reference, current, delay
and limits of the motion. The vehicle follows the saved thrusts, so that both versions solve the same problems. The
largest difference of a cycle and the cycles beyond ``TOLERANCE_N`` are printed; exit 1 if there are any.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from ltv_mpc import Controller, ControllerConfig, CurrentProfile, Estimate, Vehicle, advance, references
from ltv_mpc.control.config import Disturbance, MotionLimits, WeightSettings
from ltv_mpc.messages import Plan
from ltv_mpc.references import Reference
from tests.ltv_mpc.reports import report

CASES, CYCLES = 100, 20
PERIOD_S = 0.3
TOLERANCE_N = 1e-6

VEHICLES = ("paper", "low-yaw", "weak-reverse", "surface")
PATHS = ("square", "lawnmower", "line", "spiral", "circle")
HORIZONS = ((5.1, 34), (10.2, 34), (13.8, 34), (24.0, 34), (20.4, 68))
"""Length (s) and largest number of stages."""


class Case(NamedTuple):
    """Closed loop of one drawn kind."""

    vehicle: Vehicle
    reference: Reference
    config: ControllerConfig
    start: Estimate
    unknown_mps: float  # current that the estimates do not contain, north
    shares: tuple[float, float]
    reports: bool  # the actuators report their thrusts


def draw(seed: int) -> Case:
    """Return the case of a seed."""
    rng = np.random.default_rng(seed)
    vehicle = Vehicle.load(VEHICLES[rng.integers(len(VEHICLES))])
    solver = "riccati" if seed % 2 else "osqp"
    horizon_s, most = HORIZONS[rng.integers(len(HORIZONS))]
    limited = solver == "osqp" and seed % 6 == 0
    limits = MotionLimits.symmetric(surge_mps=0.4, yaw_rate_radps=0.3) if limited else MotionLimits()
    config = ControllerConfig(
        horizon_s=horizon_s,
        max_stages=most,
        solver=solver,
        limits=limits,
        weights=WeightSettings(
            thrust=float(rng.choice([0.003, 0.03])), thrust_change=float(rng.choice([0.0015, 0.015]))
        ),
        sqp_iterations=int(rng.integers(1, 4)),
        disturbance=Disturbance(sd_mps=(None, 0.0, 0.1)[rng.integers(3)]),
        first_delay_s=(0.05, 0.71)[rng.integers(2)],
    )
    reach_m, heading = float(rng.choice([0.0, 0.5, 5.0, 30.0])), float(rng.uniform(-3.1, 3.1))
    depth_m = None if vehicle.heave is None else 5.0
    path = rng.integers(2 * len(PATHS))
    if path < len(PATHS):
        reference = references.load(PATHS[path])
    else:
        reference = references.Point(north_m=reach_m, east_m=-0.3 * reach_m, depth_m=None if depth_m is None else 9.0)
    profile = CurrentProfile(
        depth_m=np.array([0.0, 6.0, 12.0]), north_mps=rng.normal(0, 0.06, 3), east_mps=rng.normal(0, 0.06, 3)
    )
    start = Estimate.at_rest(depth_m=depth_m, heading_rad=heading)
    if rng.integers(3):
        start = msgspec.structs.replace(start, current=profile)
    shares = (1.0, float(rng.choice([1.0, 1.0, 0.6])))
    return Case(vehicle, reference, config, start, float(rng.normal(0, 0.03)), shares, bool(rng.integers(2)))


def thrusts(case: Case, driven_by: np.ndarray | None) -> np.ndarray:
    """Return the thrusts (CYCLES, N+1, 3) in N; the vehicle follows ``driven_by`` of the same shape, or these."""
    controller = Controller(case.vehicle, case.reference, case.config)
    if case.shares != (1.0, 1.0):
        controller.set_thrust_shares(case.shares)
    estimate, found = case.start, []
    rng = np.random.default_rng(1)
    for k in range(CYCLES):
        drift = case.unknown_mps * k * PERIOD_S
        seen = msgspec.structs.replace(
            estimate,
            north_m=estimate.north_m + drift,
            velocity_north_mps=estimate.velocity_north_mps + case.unknown_mps,
        )
        if rng.integers(8) == 0:  # a gust, which makes the previous plan a bad guess
            seen = msgspec.structs.replace(seen, yaw_rate_radps=seen.yaw_rate_radps + 0.1)
        plan: Plan = controller.plan(seen)
        found.append(plan.thrust_N)
        followed = plan if driven_by is None else msgspec.structs.replace(plan, thrust_N=driven_by[k])
        estimate = advance(case.vehicle, estimate, followed, duration_s=PERIOD_S)
        if case.reports:
            command = controller.sent_commands.at(np.array([estimate.t_ns]))[0]
            controller.add_report(report(estimate.t_ns, command))
    return np.array(found)


def main() -> int:
    """Save or compare the thrusts of all cases."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--save", type=Path, help="write the thrusts to this .npz file")
    parser.add_argument("--against", type=Path, help="compare with the thrusts in this .npz file")
    options = parser.parse_args()
    old = {} if options.against is None else dict(np.load(options.against))
    found: dict[str, np.ndarray] = {}
    beyond, largest = 0, 0.0
    for seed in range(CASES):
        case, before = draw(seed), old.get(str(seed))
        found[str(seed)] = after = thrusts(case, before)
        if before is None:
            continue
        apart = np.abs(after - before).max(axis=(1, 2))
        beyond, largest = beyond + int((apart > TOLERANCE_N).sum()), max(largest, float(apart.max()))
        if apart.max() > TOLERANCE_N:
            at = int(np.argmax(apart > TOLERANCE_N))
            limits = ", motion limits" if case.config.limits != MotionLimits() else ""
            kind = f"{case.vehicle.name}, {case.config.solver}, {case.config.horizon_s:g} s{limits}"
            print(f"case {seed} ({kind}): {apart.max():.3g} N, first in cycle {at}")
    if options.save is not None:
        np.savez(options.save, **found)
    if old:
        print(f"{CASES * CYCLES} cycles: largest difference {largest:.3g} N, {beyond} beyond {TOLERANCE_N:g} N")
    return 1 if beyond else 0


if __name__ == "__main__":
    sys.exit(main())
