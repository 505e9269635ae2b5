"""Paper's order of the errors, 5 s of horizon < 2.5 s < no control: the part of the open settings in which it holds.

    .venv/bin/python -m benchmarks.paper_order RESULTS.json [--points N] [--seeds N] [--picture FILE.png]

The paper's cost (positions only, and weights on thrust) and its delays, state known. A Sobol sample draws what the
paper leaves open; each point is flown without control and with both horizons, on the same seeds. The error is the mean
distance from the line over the whole descent. RESULTS.json is written after every point; the same command continues.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple
from unittest import mock

import msgspec
import numpy as np
from matplotlib.figure import Figure
from scipy.stats import binomtest, qmc

from benchmarks import sheet
from benchmarks.loop import Loop, run_config
from benchmarks.paper.settings import COMPUTING_S, LONG_S, SHORT_S
from ltv_mpc.control import config, controller, fallback, lateral, solvers
from ltv_mpc.vehicle.parameters import Vehicle
from services.reporting.plots import palette

SAMPLE_SEED, FIRST_SEED = 2012, 700
AT_REST = 1.0 / 3.0
"""Part of the sample that starts at rest over ground; the others have drifted with the water for 1 to 60 s."""


class Factor(NamedTuple):
    """Setting that the paper leaves open, and its range; ``is_log`` makes the sample uniform in its logarithm."""

    name: str
    low: float
    high: float
    is_log: bool = True

    def at(self, part: float) -> float:
        """Return the value at a part (0 to 1) of the range."""
        if self.is_log:
            return self.low * (self.high / self.low) ** part
        return self.low + part * (self.high - self.low)


FACTORS = (
    Factor("slew limit (N/s)", 5.0, 200.0),
    Factor("stage length (s)", 0.15, 0.6),
    Factor("weight on thrust", 1e-5, 1.0),
    Factor("weight on its change", 1e-5, 1.0),
    Factor("time adrift (s)", 0.0, 1.0, is_log=False),  # see ``adrift_s``
    Factor("heading at the start (rad)", -math.pi, math.pi, is_log=False),
    Factor("delay over the paper's", 0.0, 1.0, is_log=False),
    Factor("lag of the thrusters (s)", 0.02, 1.0),
    Factor("correlation length of the current (m)", 2.0, 40.0),
    Factor("yaw damping (kg m2)", 50.0, 800.0),
)
WEIGHT = 2
"""Index of the weight on thrust."""

DECIDING_WEIGHT = 0.02
"""Weight on thrust that divides the sample: full thrust of one thruster then costs as much as 0.14 m off the line."""

NONE = "none"
CONTROLS: dict[str, float | None] = {NONE: None, "2.5 s": SHORT_S, "5 s": LONG_S}

CLAIMS: dict[str, Callable[[dict[str, float]], bool]] = {
    "5 s < 2.5 s": lambda e: e["5 s"] < e["2.5 s"],
    "2.5 s < none": lambda e: e["2.5 s"] < e[NONE],
    "5 s < none": lambda e: e["5 s"] < e[NONE],
    "the paper's order": lambda e: e["5 s"] < e["2.5 s"] < e[NONE],
}


def adrift_s(part: float) -> float:
    """Return the time adrift (s) at a part of the sample; 0: at rest over ground."""
    return 0.0 if part < AT_REST else 60.0 ** ((part - AT_REST) / (1.0 - AT_REST))


def error_m(x: Sequence[float], horizon_s: float | None, seed: int) -> float:
    """Return the mean distance (m) from the line in one descent; without a horizon it is not controlled."""
    slew, stage_s, thrust, change, part, heading, delay, lag, length, damping = x
    settings = (
        f"run.seed={seed}",
        f"run.surface_time_s={max(adrift_s(part), 1.0)}",
        f"plant.heading_rad={heading}",
        f"water.correlation_length_m={length}",
        f"controller.horizon_s={horizon_s or SHORT_S}",
        f"controller.period_s={stage_s}",
        f"controller.weights.thrust={thrust}",
        f"controller.weights.thrust_change={change}",
        "controller.weights.terminal_position_per_m2=0.0",
        "controller.weights.terminal_velocity_s2_per_m2=0.0",
    )
    if horizon_s is None:
        settings += ("controller.lateral=false",)
    else:
        settings += (f"run.compute_delay_s={delay * COMPUTING_S[horizon_s]}",)
    run = run_config(*settings)
    run = dataclasses.replace(run, vehicle=changed(run.vehicle, slew, lag, damping))
    stage_ns = round(stage_s * 1e9)
    with ExitStack() as changes:
        for module in (config, controller, fallback, lateral, solvers):
            changes.enter_context(mock.patch.object(module, "STAGE_NS", stage_ns))
        changes.enter_context(mock.patch.object(controller, "STAGE_S", stage_s))
        mpc = controller.Controller(run.vehicle, run.reference, run.scenario.controller)
        return Loop(run_config=run, controller=mpc, at_rest=part < AT_REST).fly().mean_m


def changed(vehicle: Vehicle, slew_N_per_s: float, lag_s: float, damping_kgm2: float) -> Vehicle:
    """Return the vehicle with these lateral thrusters and this quadratic yaw damping."""
    port, starboard = (
        msgspec.structs.replace(thruster, slew_N_per_s=slew_N_per_s, lag_s=lag_s) for thruster in vehicle.thrusters[:2]
    )
    return msgspec.structs.replace(
        vehicle,
        thruster=msgspec.structs.replace(vehicle.thruster, port=port, starboard=starboard),
        yaw=msgspec.structs.replace(vehicle.yaw, quadratic_damping_kgm2=damping_kgm2),
    )


def sample(points: int) -> list[list[float]]:
    """Return the settings of each point, in the order of ``FACTORS``."""
    parts = qmc.Sobol(len(FACTORS), seed=SAMPLE_SEED).random(points)
    return [[factor.at(float(part)) for factor, part in zip(FACTORS, row, strict=True)] for row in parts]


def share(holds: np.ndarray) -> str:
    """Return the percentage of points in which something holds, with its exact 95 % interval."""
    interval = binomtest(int(holds.sum()), len(holds)).proportion_ci()
    return f"{100 * np.mean(holds):.0f} % ({100 * interval.low:.0f} to {100 * interval.high:.0f})"


def tables(points: Sequence[list[float]], errors: Sequence[dict[str, float]]) -> str:
    """Return the share of points in which each claim holds, by the weight on thrust and by thirds of each factor."""
    x = np.array(points)
    heavy = x[:, WEIGHT] >= DECIDING_WEIGHT
    holds = {name: np.array([claim(e) for e in errors]) for name, claim in CLAIMS.items()}
    rows = [f"| claim | all {len(x)} points | weight below {DECIDING_WEIGHT} | above |", "|---|---|---|---|"]
    rows += [f"| {name} | {share(h)} | {share(h[~heavy])} | {share(h[heavy])} |" for name, h in holds.items()]
    rows += ["", f"| 2.5 s < none, weight below {DECIDING_WEIGHT}, by thirds of | lowest | middle | highest |"]
    rows += ["|---|---|---|---|"]
    light, held = x[~heavy], holds["2.5 s < none"][~heavy]
    for i, factor in enumerate(FACTORS):
        thirds = np.array_split(np.argsort(light[:, i], kind="stable"), 3)
        rows.append(f"| {factor.name} | {' | '.join(share(held[third]) for third in thirds)} |")
    return "\n".join(rows)


def draw(points: Sequence[list[float]], errors: Sequence[dict[str, float]], path: Path) -> None:
    """Draw the error at 2.5 s over that without control against each factor."""
    ratio = np.array([e["2.5 s"] / e[NONE] for e in errors])
    holds = np.array([CLAIMS["the paper's order"](e) for e in errors])
    with sheet.style(page=True):
        figure = Figure(figsize=(11.0, 5.6), layout="constrained")
        axes = figure.subplots(2, 5, sharey=True)
        for i, (factor, axis) in enumerate(zip(FACTORS, axes.flat, strict=True)):
            x = np.array([point[i] for point in points])
            if factor.name == "time adrift (s)":
                x = np.array([adrift_s(part) for part in x])
            for those, colour, marker, label in (
                (holds, palette.RUNS[0], "o", "5 s < 2.5 s < no control"),
                (~holds, palette.RUNS[1], "x", "another order"),
            ):
                axis.plot(x[those], ratio[those], marker, color=colour, label=label)
            axis.axhline(1.0, color=palette.REFERENCE, linewidth=0.8)
            axis.set(xlabel=factor.name, xscale="log" if factor.is_log else "linear", yscale="log")
            axis.minorticks_off()
            ticks = [factor.at(part) for part in (0.0, 0.5, 1.0)] if factor.is_log else axis.get_xticks()[1:-1]
            axis.set_xticks(ticks, [f"{tick:.3g}" for tick in ticks])
            axis.set_yticks([0.2, 0.5, 1.0, 2.0, 5.0], ["0.2", "0.5", "1", "2", "5"])
        figure.supylabel("mean error at 2.5 s of horizon over that without control", fontsize="medium")
        sheet.shared_legend(figure, axes[0][0])
        sheet.write(figure, [path])


def main() -> None:
    """Fly the missing points, then print and draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("results", type=Path)
    parser.add_argument("--points", type=int, default=64)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--picture", type=Path)
    options = parser.parse_args()
    points = sample(options.points)
    flown = json.loads(options.results.read_text()) if options.results.exists() else []
    for k in range(len(flown), len(points)):
        seeds = range(FIRST_SEED + k * options.seeds, FIRST_SEED + (k + 1) * options.seeds)
        means = {
            name: round(float(np.mean([error_m(points[k], horizon_s, seed) for seed in seeds])), 4)
            for name, horizon_s in CONTROLS.items()
        }
        settings = {factor.name: float(f"{x:.4g}") for factor, x in zip(FACTORS, points[k], strict=True)}
        flown.append({"settings": settings, "error_m": means})
        options.results.write_text("[\n" + ",\n".join(map(json.dumps, flown)) + "\n]\n")
        print(k, {name: round(mean, 3) for name, mean in means.items()}, flush=True)
    errors = [point["error_m"] for point in flown[: len(points)]]
    print(tables(points, errors))
    if options.picture is not None:
        draw(points, errors, options.picture)


if __name__ == "__main__":
    main()
