"""Error against propulsive power of the paper's descent, one curve a horizon: where the default weights come from.

    .venv/bin/python -m benchmarks.pareto [--seeds FIRST:END] [--out FILE.json] [--figure FILE.png]
    .venv/bin/python -m benchmarks.pareto --draw FILE.json --figure FILE.png

State known. A propeller needs a power that is proportional to |F|^1.5, so P is the mean of |F|^1.5 over time and both
lateral thrusters. Along a curve both weights on thrust change together, thrust : change = 2 : 1. The tuning used seeds
from 200 up, which no other table reports.
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
from matplotlib.figure import Figure

from benchmarks import sheet
from benchmarks.loop import Loop, Outcome, run_config
from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.control.controller import Controller
from ltv_mpc.control.resolution import settled
from ltv_mpc.control.scaling import THRUST_WEIGHT_FACTOR
from ltv_mpc.vehicle.parameters import Vehicle
from services.reporting.plots import palette
from services.tools.batch.executor import run_each

HORIZONS_S = (5.1, 10.2, 13.8, 20.1)
THRUST = (0.003, 0.01, 0.03, 0.1, 0.3)
CHANGE_RATIO = 0.5
"""Weight on the change of thrust over that on thrust."""


class Job(NamedTuple):
    """One descent."""

    horizon_s: float
    thrust: float
    change: float
    seed: int


class Point(msgspec.Struct, frozen=True, kw_only=True):
    """Means over seeds, with the half width of their 95 % interval and the worst seed."""

    horizon_s: float
    thrust: float
    change: float
    seeds: int
    error_m: float
    error_pm_m: float
    error_worst_m: float
    power: float  # mean |F|^1.5 (N^1.5)
    power_pm: float
    abs_F_N: float
    saturated: float
    saturated_worst: float


def power(outcome: Outcome) -> float:
    """Return the propulsive power up to a factor: the mean |F|^1.5 over time and both lateral thrusters (N^1.5)."""
    return float(np.mean(np.abs(outcome.commands_N) ** 1.5))


def fly(*settings: str) -> tuple[float, float, float, float]:
    """Return mean error (m), power (N^1.5), mean |F| (N) and saturated share of a descent with these settings."""
    here = run_config(*settings)
    outcome = Loop(run_config=here, controller=Controller(here.vehicle, here.reference, here.controller)).fly()
    return outcome.mean_m, power(outcome), outcome.mean_abs_N, outcome.saturated


def one(job: Job) -> tuple[float, float, float, float]:
    """Return the figures of one descent."""
    return fly(
        f"run.seed={job.seed}",
        f"controller.horizon_s={job.horizon_s}",
        f"controller.weights.thrust={job.thrust}",
        f"controller.weights.thrust_change={job.change}",
    )


def half_width(values: list[float]) -> float:
    """Return the half width of the mean's 95 % interval."""
    return 1.96 * statistics.stdev(values) / len(values) ** 0.5 if len(values) > 1 else float("nan")


def point(job: Job, figures: list[tuple[float, float, float, float]]) -> Point:
    """Return the means over the seeds of one setting."""
    error, power_of, force, saturated = (list(column) for column in zip(*figures, strict=True))
    return Point(
        horizon_s=job.horizon_s,
        thrust=job.thrust,
        change=job.change,
        seeds=len(figures),
        error_m=statistics.fmean(error),
        error_pm_m=half_width(error),
        error_worst_m=max(error),
        power=statistics.fmean(power_of),
        power_pm=half_width(power_of),
        abs_F_N=statistics.fmean(force),
        saturated=statistics.fmean(saturated),
        saturated_worst=max(saturated),
    )


def draw(points: list[Point], path: Path) -> None:
    """Draw error against power, one curve a horizon; the default and the efforts are marked."""
    with sheet.style(page=True):
        figure = Figure(figsize=(sheet.PAGE_IN, 4.4), layout="constrained")
        panel = figure.subplots()
        for horizon_s in sorted({of.horizon_s for of in points}):
            curve = sorted((of for of in points if of.horizon_s == horizon_s), key=lambda of: of.thrust)
            label = f"horizon {horizon_s:g} s"
            panel.plot([of.power for of in curve], [1e3 * of.error_m for of in curve], "o-", label=label)
        proposed = settled(ControllerConfig(), Vehicle.load("paper"))
        for of in points:
            for effort, factor in THRUST_WEIGHT_FACTOR.items():
                if of.horizon_s == proposed.horizon_s and math.isclose(of.thrust, factor * proposed.weights.thrust):
                    labels = {"normal": "effort normal, default", "low": "effort low or high"}
                    mark, size, label = ("*" if effort == "normal" else "s"), 8, labels.get(effort)
                    at = of.power, 1e3 * of.error_m
                    panel.plot(*at, mark, color=palette.TRUTH, markersize=size, label=label)
                    place = (9, -4) if effort == "high" else (7, 6)  # beside the line of a shorter horizon
                    panel.annotate(effort, at, place, textcoords="offset points")
        panel.set(xscale="log", yscale="log", xlabel="propulsive power, mean $|F|^{1.5}$ (N$^{1.5}$)")
        panel.set(ylabel="tracking error, mean (mm)")
        panel.set_xticks(ticks := (10, 15, 20, 30, 40, 60, 80), map(str, ticks))
        panel.set_yticks(ticks := (10, 15, 20, 30, 50, 100, 200), map(str, ticks))
        panel.minorticks_off()
        sheet.legend_above(panel, "tracking error against propulsive power")
        sheet.write(figure, [path])


def main() -> None:
    """Run or read, print, keep and draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="200:204", help="FIRST:END")
    parser.add_argument("--horizons", type=float, nargs="+", default=HORIZONS_S)
    parser.add_argument("--thrust", type=float, nargs="+", default=THRUST)
    parser.add_argument("--change-ratio", type=float, default=CHANGE_RATIO)
    parser.add_argument("--workers", type=int)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--draw", type=Path, help="draw the data of this file, run nothing")
    parser.add_argument("--figure", type=Path)
    options = parser.parse_args()
    if options.draw is None:
        points = search(options)
    else:
        points = msgspec.convert(json.loads(options.draw.read_text())["points"], list[Point])
    print("| horizon | thrust, change | error (m) | worst | P | abs F (N) | saturated (%) |")
    print("|---|---|---|---|---|---|---|")
    for of in points:
        error = f"{of.error_m:.4f} ± {of.error_pm_m:.4f} | {of.error_worst_m:.4f}"
        thrust = f"{of.power:.1f} ± {of.power_pm:.1f} | {of.abs_F_N:.1f} | {100 * of.saturated:.2f}"
        print(f"| {of.horizon_s:g} s | {of.thrust:g}, {of.change:g} | {error} | {thrust} |")
    if options.out is not None:
        data: dict[str, Any] = {"seeds": options.seeds, "points": msgspec.to_builtins(points)}
        options.out.write_text(json.dumps(data, indent=1) + "\n")
    if options.figure is not None:
        draw(points, options.figure)


def search(options: argparse.Namespace) -> list[Point]:
    """Fly all settings on all seeds."""
    first, end = map(int, options.seeds.split(":"))
    jobs = [
        Job(horizon_s, thrust, options.change_ratio * thrust, seed)
        for seed in range(first, end)
        for horizon_s in options.horizons
        for thrust in options.thrust
    ]
    found: dict[Job, list[tuple[float, float, float, float]]] = {}
    for place, figures in run_each(one, jobs, workers=options.workers):
        found.setdefault(jobs[place]._replace(seed=0), []).append(figures)
    return [point(job, found[job]) for job in dict.fromkeys(job._replace(seed=0) for job in jobs)]


if __name__ == "__main__":
    main()
