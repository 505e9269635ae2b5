"""Defaults against those before them, paired by seed: error, propulsive power, saturation.

    .venv/bin/python -m benchmarks.defaults [--seeds FIRST:END] [--full] [--vehicles NAME|FILE ...] [--efforts ...]
                                            [--against KEY=VALUE ...]

Before: 5 s of horizon and a tenth of today's weights on thrust, ``effort = "high"``, for every vehicle; or the defaults
with the settings of --against, such as ``controller.sqp_iterations=1``. Descents in the paper's water with the state
known; with ``--full`` with realistic sensors and 30 fixes. A craft that does not dive keeps its point for the same
time, in a current that changes by 1 cm/s per square root of a second. P is the mean of |F|^1.5; with ``--full`` it is
the mean |F| to the power of 1.5. Intervals hold 95 % of the means of as many seeds.
"""

from __future__ import annotations

import argparse
import statistics
from typing import NamedTuple

from benchmarks.pareto import fly, half_width
from ltv_mpc.vehicle.parameters import Vehicle
from services.tools.batch.executor import run_each
from services.tools.batch.job import Job as LockstepJob

BEFORE = ("controller.horizon_s=5.0", "controller.effort=high")
CHANGING = "water.change_mps_per_rts=0.01"


class Job(NamedTuple):
    """One run."""

    vehicle: str
    name: str  # "before", or an effort
    full: bool
    seed: int
    before: tuple[str, ...] = BEFORE


class Figures(NamedTuple):
    """Figures of one run."""

    error_m: float
    power: float
    abs_F_N: float
    saturated: float


def one(job: Job) -> Figures:
    """Return the figures of one run."""
    own = job.before if job.name == "before" else (f"controller.effort={job.name}",)
    dives = Vehicle.load(job.vehicle).can_dive
    settings = (f"run.seed={job.seed}", f"vehicle={job.vehicle}", *own, *(() if dives else (CHANGING,)))
    if not job.full:
        return Figures(*fly(*settings))
    of = LockstepJob("descent", (*settings, "sensors=realistic", "run.surface_time_s=30.0")).summary()
    error_m, abs_F_N, saturated = of.true_error_m.mean, of.thrust.mean_abs_N, of.thrust.saturated_fraction
    assert error_m is not None
    assert abs_F_N is not None
    assert saturated is not None
    return Figures(error_m, abs_F_N**1.5, abs_F_N, saturated)


def row(vehicle: str, name: str, found: list[Figures], before: list[Figures]) -> str:
    """Return the line of one setting, with its differences from the setting before."""
    error, power, force, saturated = (list(column) for column in zip(*found, strict=True))
    change = [a.error_m - b.error_m for a, b in zip(found, before, strict=True)]
    ratio = statistics.fmean(power) / statistics.fmean(of.power for of in before)
    return (
        f"| {vehicle}, {name} | {statistics.fmean(error):.4f} ± {half_width(error):.4f} | {max(error):.4f} "
        f"| {statistics.fmean(change):+.4f} ± {half_width(change):.4f} | {statistics.fmean(power):.1f} ± "
        f"{half_width(power):.1f} | {ratio:.2f} | {statistics.fmean(force):.1f} "
        f"| {100 * statistics.fmean(saturated):.2f} | {100 * max(saturated):.2f} |"
    )


def main() -> None:
    """Run and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="0:20", help="FIRST:END")
    parser.add_argument("--vehicles", nargs="+", default=["paper"])
    parser.add_argument("--efforts", nargs="+", default=["normal"])
    parser.add_argument("--full", action="store_true", help="with the estimator and realistic sensors")
    parser.add_argument("--against", nargs="+", default=BEFORE, help="settings of the first row of each vehicle")
    parser.add_argument("--workers", type=int)
    options = parser.parse_args()
    first, end = map(int, options.seeds.split(":"))
    names, before = ["before", *options.efforts], tuple(options.against)
    jobs = [
        Job(vehicle, name, options.full, seed, before)
        for vehicle in options.vehicles
        for seed in range(first, end)
        for name in names
    ]
    found = {jobs[place]: figures for place, figures in run_each(one, jobs, workers=options.workers)}
    title = f"mean of {end - first} seeds | error (m) | worst seed | change, paired | P | ratio | abs F (N)"
    print(f"| {title} | saturated (%) | worst seed |\n|{'---|' * 9}")
    for vehicle in options.vehicles:
        runs = {
            name: [found[Job(vehicle, name, options.full, seed, before)] for seed in range(first, end)]
            for name in names
        }
        for name in names:
            print(row(vehicle, name, runs[name], runs["before"]))


if __name__ == "__main__":
    main()
