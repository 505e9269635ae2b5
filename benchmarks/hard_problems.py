"""Solver failures on random hard problems with motion limits.

    .venv/bin/python -m benchmarks.hard_problems [--problems N] [--first-seed N] [--solver NAME] [--keep DIR]

Each problem puts one of the shipped vehicles 0.5 to 30 m off a point: any heading, any velocity and yaw rate within
half of what it can do, a current of at most a third of its top speed, and limits of surge speed, yaw rate or both at 20
to 100 % of its largest ones. The controller then runs ``CYCLES`` cycles, at the horizon proposed for the vehicle, with
the vehicle moving as predicted. A cycle fails if its plan is not that of a solved QP. The time of a cycle is the
processor time of the thread.
"""

from __future__ import annotations

import argparse
import functools
import math
import time
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from benchmarks.batch import in_order
from ltv_mpc.control.config import ControllerConfig, MotionLimits
from ltv_mpc.control.controller import Controller
from ltv_mpc.control.nominal_model import advance
from ltv_mpc.control.resolution import settled
from ltv_mpc.control.solvers.recorder import QpRecorder
from ltv_mpc.messages import CurrentProfile, Estimate, SolveStatus
from ltv_mpc.references import Point
from ltv_mpc.vehicle.parameters import Vehicle
from ltv_mpc.vehicle.performance import Performance, performance

VEHICLES = ("paper", "low-yaw", "surface", "weak-reverse")

CYCLES = 5
"""Control cycles of a problem: the first has no warm start."""

MAX_CURRENT_SHARE = 1 / 3
"""Largest current over the top speed ahead."""


class Job(NamedTuple):
    """One problem."""

    seed: int
    solver: str
    keep: Path | None  # folder for the QPs that were not solved


class Solved(NamedTuple):
    """Result of the cycles of one problem."""

    vehicle: str
    status: list[SolveStatus]
    iterations: list[int]
    cycle_us: list[float]


@functools.cache
def craft(name: str) -> tuple[Vehicle, Performance, float]:
    """Return a shipped vehicle, its performance and its horizon (s)."""
    vehicle = Vehicle.load(name)
    return vehicle, performance(vehicle), settled(ControllerConfig(), vehicle).horizon_s


def draw(seed: int, name: str) -> tuple[ControllerConfig, Estimate]:
    """Draw the settings and the first estimate of a problem; the point lies at the origin.

    Parameters
    ----------
    seed : of the problem.
    name : of the shipped vehicle.
    """
    rng = np.random.default_rng([seed, 5])
    _, can, horizon_s = craft(name)
    top, turn = can.top_speed_ahead_mps or 0.0, can.turning_rate_starboard_radps or 0.0
    kind, shares = rng.integers(3), rng.uniform(0.2, 1.0, 2)
    limits = MotionLimits.symmetric(
        surge_mps=float(shares[0] * top) if kind != 0 else None,
        yaw_rate_radps=float(shares[1] * turn) if kind != 1 else None,
    )
    away, bearing, heading, course, set_to = rng.uniform([0.5, *[-math.pi] * 4], [30.0, *[math.pi] * 4])
    speed, drift = rng.uniform(0.0, top * np.array([0.5, MAX_CURRENT_SHARE]))
    current = drift * np.cos(set_to), drift * np.sin(set_to)
    estimate = msgspec.structs.replace(
        Estimate.at_rest(
            north_m=float(away * np.cos(bearing)), east_m=float(away * np.sin(bearing)), heading_rad=float(heading)
        ),
        yaw_rate_radps=float(rng.uniform(-0.5, 0.5) * turn),
        velocity_north_mps=float(speed * np.cos(course) + current[0]),
        velocity_east_mps=float(speed * np.sin(course) + current[1]),
        current=CurrentProfile(
            depth_m=np.array([0.0, 1.0]), north_mps=np.full(2, current[0]), east_mps=np.full(2, current[1])
        ),
    )
    return ControllerConfig(horizon_s=horizon_s, limits=limits), estimate


def one(job: Job) -> Solved:
    """Run the cycles of one problem."""
    name = VEHICLES[job.seed % len(VEHICLES)]
    config, estimate = draw(job.seed, name)
    vehicle, _, _ = craft(name)
    failures = QpRecorder()
    config = msgspec.structs.replace(config, solver=job.solver)
    controller = Controller(vehicle, Point(north_m=0.0, east_m=0.0), config, make_solver=failures)
    solved = Solved(name, [], [], [])
    for cycle in range(CYCLES):
        started = time.thread_time_ns()
        plan = controller.plan(estimate)
        solved.cycle_us.append((time.thread_time_ns() - started) / 1000)
        solved.status.append(plan.solve.status)
        solved.iterations.append(plan.solve.iterations)
        if failures.failed is not None and job.keep is not None:
            failures.failed.save(job.keep / f"{job.seed}-{cycle}.qp")
            failures.failed = None
        estimate = advance(vehicle, estimate, plan, duration_s=config.period_s)
    return solved


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--problems", type=int, default=10_000)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--solver", default="osqp")
    parser.add_argument("--workers", type=int)
    parser.add_argument("--keep", type=Path, help="folder for the QPs that were not solved: ltv-mpc qp show")
    options = parser.parse_args()
    if options.keep is not None:
        options.keep.mkdir(parents=True, exist_ok=True)
    seeds = range(options.first_seed, options.first_seed + options.problems)
    jobs = [Job(seed, options.solver, options.keep) for seed in seeds]
    found = in_order(one, jobs, workers=options.workers)
    failed = Counter(
        (run.vehicle, status) for run in found for status in run.status if status is not SolveStatus.SOLVED
    )
    by_kind = ", ".join(f"{vehicle} {status} {count}" for (vehicle, status), count in failed.items())
    print(f"{len(found) * CYCLES} cycles, {failed.total()} not solved: {by_kind or 'none'}")
    for name, values in (
        ("iterations", [run.iterations for run in found]),
        ("time of a cycle (us)", [run.cycle_us for run in found]),
    ):
        median, most, longest = np.quantile(values, [0.5, 0.999, 1.0])
        print(f"{name}: median {median:.0f}, 99.9 % {most:.0f}, largest {longest:.0f}")


if __name__ == "__main__":
    main()
