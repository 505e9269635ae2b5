"""Cost of soft motion limits, and how well they are kept.

    .venv/bin/python -m benchmarks.motion_limits [--seeds N] [--workers N]

The paper's descent with the state known, seeds 0 to N-1 (20), 5.1 s of horizon: without limits, and asked to turn or to
go no faster than so much (``[controller.limits]``).
"""

from __future__ import annotations

import argparse
import math
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.progress import Progress

from benchmarks.loop import Loop, run_config
from ltv_mpc.control.controller import Controller
from ltv_mpc.control.prediction import currents_at_depths
from ltv_mpc.messages import Array, Estimate, Plan, SolveStatus
from services.tools.batch.executor import run_each

LIMITS: tuple[tuple[str, ...], ...] = (
    (),
    ("min_yaw_rate_radps=-0.2", "max_yaw_rate_radps=0.2"),
    ("min_yaw_rate_radps=-0.15", "max_yaw_rate_radps=0.15"),
    ("min_yaw_rate_radps=-0.1", "max_yaw_rate_radps=0.1"),
    ("min_surge_mps=-0.2", "max_surge_mps=0.2"),
    ("min_surge_mps=-0.15", "max_surge_mps=0.15"),
)


class Job(NamedTuple):
    """One descent."""

    limits: tuple[str, ...]
    seed: int


class Flown(NamedTuple):
    """Result of a flight, cycle by cycle without the first two."""

    mean_m: float
    mean_abs_N: float
    yaw_rate: Array  # |r| (rad/s)
    surge: Array  # |u| through the water (m/s)
    iterations: Array
    unsolved: int


def one(job: Job) -> Flown:
    """Fly it."""
    s = run_config(f"run.seed={job.seed}", *(f"controller.limits.{limit}" for limit in job.limits))
    seen: list[tuple[float, float, int, bool]] = []

    def look(estimate: Estimate, plan: Plan) -> None:
        water = currents_at_depths(estimate.current, np.array([estimate.depth_m]))[0]
        past = estimate.velocity_north_mps - water[0], estimate.velocity_east_mps - water[1]
        surge = past[0] * math.cos(estimate.heading_rad) + past[1] * math.sin(estimate.heading_rad)
        solved = plan.solve.status is SolveStatus.SOLVED
        seen.append((abs(estimate.yaw_rate_radps), abs(surge), plan.solve.iterations, solved))

    outcome = Loop(run_config=s, controller=Controller(s.vehicle, s.reference, s.scenario.controller), seen=look).fly()
    rate, surge, iterations, solved = np.array(seen).T
    return Flown(outcome.mean_m, outcome.mean_abs_N, rate, surge, iterations, int((solved == 0).sum()))


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--workers", type=int)
    options = parser.parse_args()
    jobs = [Job(limits, seed) for limits in LIMITS for seed in range(options.seeds)]
    flown: dict[tuple[str, ...], list[Flown]] = {}
    with Progress(console=Console(stderr=True)) as progress:
        task = progress.add_task(f"{len(jobs)} descents", total=len(jobs))
        for place, result in run_each(one, jobs, workers=options.workers):
            flown.setdefault(jobs[place].limits, []).append(result)
            progress.advance(task)
    print(
        f"| limit, {options.seeds} seeds | error (m) | mean abs F (N) | yaw rate: 99 %, largest (rad/s) | "
        "surge: 99 %, largest (m/s) | iterations: median, 99 % | at the iteration limit |"
    )
    print("|---|---|---|---|---|---|---|")
    for limits in LIMITS:
        runs = flown[limits]
        rate, surge, iterations = (np.concatenate([getattr(run, name) for run in runs]) for name in Flown._fields[2:5])
        unsolved, cycles = sum(run.unsolved for run in runs), len(rate)
        print(
            f"| {', '.join(limits) or 'none'} | {np.mean([run.mean_m for run in runs]):.3f} | "
            f"{np.mean([run.mean_abs_N for run in runs]):.1f} | {np.quantile(rate, 0.99):.3f}, {rate.max():.3f} | "
            f"{np.quantile(surge, 0.99):.3f}, {surge.max():.3f} | {np.median(iterations):.0f}, "
            f"{np.quantile(iterations, 0.99):.0f} | {unsolved} of {cycles} |"
        )


if __name__ == "__main__":
    main()
