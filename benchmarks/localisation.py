"""Cost of localisation against the number of water cells: processor seconds per second of vehicle time.

    .venv/bin/python -m benchmarks.localisation [--json] [--out FILE.png] [--repeats N] [--sensors NAME]

One simulated descent is heard again and again by filters that differ in their cells alone. Measured are
    filter  its own computing: inertial samples, corrections, the window, what it grants changing water
    node    the whole estimator through ``steps``: besides, the history for late messages, the watch over every sensor
            and ten estimates a second
Processor time, not wall time. Settings take turns, N times (9): the machine may be shared, so the least is the cost,
and the median says how much of it the others took.
"""

from __future__ import annotations

import argparse
import itertools
import json
import statistics
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
from matplotlib.figure import Figure
from rich.console import Console
from rich.progress import Progress

from benchmarks import sheet
from benchmarks.lockstep_job import Job
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.estimator import Estimator
from ltv_mpc.localisation.filter.error_state_filter import ErrorStateFilter
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.sensors import BY_MESSAGE
from ltv_mpc.messages import ImuSample, ImuSamples
from ltv_mpc.node import Inbox
from services.reporting.plots import palette
from services.run.nodes import make_nodes
from services.tools import lockstep_run
from sim.scheduler import LockStep, Observation, Step

CELLS = (25, 50, 70, 140, 280, 500)
DESCENT_S = 60.0
DEFAULT = EstimatorConfig()

LIMITS = {70: 0.005, 500: 0.10}
"""Share of a core that the filter may take where every cell is kept."""


class Curve(NamedTuple):
    """Curve of the figure: what is measured, with which setting, and its colour and marker."""

    name: str
    node: bool  # the whole, not the filter alone
    kept_m: float
    colour: str
    marker: str
    line: str


CURVES = (
    Curve("filter, every cell kept", False, 2000.0, palette.RUNS[0], "o", "-"),
    Curve(f"filter, {DEFAULT.kept_m:g} m behind kept (default)", False, DEFAULT.kept_m, palette.RUNS[1], "s", "-"),
    Curve("filter, none behind kept", False, 0.0, palette.RUNS[2], "^", "-"),
    Curve("whole node, every cell kept", True, 2000.0, palette.OTHER, "D", "--"),
)


class Cost(NamedTuple):
    """Cost at one point of a curve, as shares of a core."""

    curve: str
    cells: int
    states: int
    least: float
    median: float


class Descent(NamedTuple):
    """Sensors of a descent, and the messages that its estimator received."""

    suite: SensorConfig
    steps: list[tuple[int, Inbox]]

    @classmethod
    def simulated(cls, sensors: str) -> Descent:
        """Run the descent once in lock step. Raises ``ConfigError``."""
        run_config = Job("descent", (f'sensors="{sensors}"', f"run.duration_s={DESCENT_S}")).run_config()
        scenario, steps = run_config.scenario, list[tuple[int, Inbox]]()

        def stepped(step: Step) -> None:
            if step.node == Estimator.name:
                steps.append((step.t_ns, step.inbox))

        nodes = make_nodes(run_config)
        LockStep(
            nodes, start_ns=scenario.start_ns, observation=Observation(on_step=stepped), latest=lockstep_run.LATEST
        ).advance(scenario.end_ns)
        return cls(run_config.sensor_config, steps)

    def aligned(self, config: EstimatorConfig) -> tuple[Estimator, list[tuple[int, Inbox]]]:
        """Return an estimator whose filter has been initialised, and the messages that remain."""
        estimator = Estimator(self.suite, config)
        for i, (t_ns, inbox) in enumerate(self.steps):
            if estimator.filter is not None:
                return estimator, self.steps[i:]
            estimator.step(t_ns, inbox)
        raise RuntimeError("the descent has not been long enough to align")


def of_node(descent: Descent, config: EstimatorConfig) -> tuple[int, float]:
    """Return the number of states and the share of a core of the node."""
    estimator, rest = descent.aligned(config)
    began, from_ns = time.process_time(), rest[0][0]
    for t_ns, inbox in rest:
        estimator.step(t_ns, inbox)
    spent = time.process_time() - began
    if estimator.filter is None:
        raise RuntimeError("the filter has been lost on the way")
    return estimator.filter.belief.layout.size, spent / ((rest[-1][0] - from_ns) * 1e-9)


def of_filter(descent: Descent, config: EstimatorConfig) -> tuple[int, float]:
    """Return the number of states and the share of a core of the filter alone: every message at its time, with the
    inertial sample across it split there.
    """
    estimator, rest = descent.aligned(config)
    if estimator.filter is None:
        raise RuntimeError("the filter has been lost on the way")
    filter_ = ErrorStateFilter(descent.suite, config, estimator.filter.belief)
    from_ns = filter_.belief.t_ns
    samples: list[ImuSample] = []
    aiding: list[Any] = []  # messages of the sensors that correct the filter
    for _, inbox in rest:
        for arrival in inbox:
            signal = arrival.message
            if isinstance(signal, ImuSamples):
                samples += signal.samples
            elif type(signal) in BY_MESSAGE:
                aiding.append(signal)
    aiding = sorted((one for one in aiding if one.t_ns > from_ns), key=lambda one: one.t_ns, reverse=True)
    began = time.process_time()
    for sample in samples:
        while aiding and aiding[-1].t_ns <= sample.t_ns:
            message = aiding.pop()
            if message.t_ns > filter_.belief.t_ns:
                filter_.advance(message.t_ns, sample)
            filter_.correct(message)
        if sample.t_ns > filter_.belief.t_ns:
            filter_.advance(sample.t_ns, sample)
    spent = time.process_time() - began
    return filter_.belief.layout.size, spent / ((filter_.belief.t_ns - from_ns) * 1e-9)


def measure(descent: Descent, curve: Curve, cells: int) -> tuple[int, float]:
    """One pass."""
    config = msgspec.structs.replace(DEFAULT, deepest_m=float(cells), kept_m=curve.kept_m)
    return (of_node if curve.node else of_filter)(descent, config)


def growth(costs: Sequence[Cost]) -> dict[str, float]:
    """Exponent of the cost in the number of states, between each number of cells and the next."""
    return {
        f"{a.cells} to {b.cells} cells": float(np.log(b.least / a.least) / np.log(b.states / a.states))
        for a, b in itertools.pairwise(costs)
        if b.states > a.states
    }


def draw(path: Path, costs: Sequence[Cost], sensors: str) -> None:
    """Draw the share of a core against the number of cells, both logarithmic."""
    with sheet.style(page=True):
        figure = Figure(figsize=(sheet.PAGE_IN, 4.8), layout="constrained")
        axes = figure.subplots()
        for curve in CURVES:
            points = [cost for cost in costs if cost.curve == curve.name]
            style = {"color": curve.colour, "marker": curve.marker, "linestyle": curve.line}
            axes.loglog([p.cells for p in points], [100 * p.least for p in points], **style, label=curve.name)
        last = 100 * next(c.least for c in costs if (c.curve, c.cells) == (CURVES[0].name, CELLS[-1]))
        reach = np.array([190.0, CELLS[-1]])
        square = last * (reach / CELLS[-1]) ** 2
        axes.loglog(reach, square, color=palette.REFERENCE, linestyle=":", label="square of the cells")
        limits = [100 * limit for limit in LIMITS.values()]
        text = "limits of the filter: " + ", ".join(f"{100 * share:g} % at {cells}" for cells, share in LIMITS.items())
        axes.plot([*LIMITS], limits, "_", color=palette.LIMIT, markersize=20, markeredgewidth=3.0, label=text)
        axes.set_xticks(CELLS, [str(cells) for cells in CELLS])
        ticks = [0.1, 0.2, 0.5, 1, 2, 5, 10]
        axes.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.minorticks_off()
        axes.set(xlim=(22, 570), ylim=(0.1, 15))
        axes.set(xlabel="water cells of 1 m in the grid", ylabel="processor time, % of one core at real time")
        sheet.legend_above(axes, f"Processor time of localisation, sensors {sensors}")
        sheet.write(figure, [path])


def main() -> None:
    """Measure, print, and draw where asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument("--sensors", default="paper")
    options = parser.parse_args()
    descent = Descent.simulated(options.sensors)
    settings = [(curve, cells) for curve in CURVES for cells in CELLS]
    measure(descent, CURVES[0], CELLS[0])  # compiles
    spent: list[list[float]] = [[] for _ in settings]
    states = [0] * len(settings)
    with Progress(console=Console(stderr=True)) as progress:
        task = progress.add_task("passes", total=options.repeats * len(settings))
        for _ in range(options.repeats):
            for i, (curve, cells) in enumerate(settings):
                states[i], share = measure(descent, curve, cells)
                spent[i].append(share)
                progress.advance(task)
    costs = [
        Cost(curve.name, cells, size, min(shares), statistics.median(shares))
        for (curve, cells), size, shares in zip(settings, states, spent, strict=True)
    ]
    exponents = growth(costs[: len(CELLS)])
    if options.json:
        table = {"sensors": options.sensors, "costs": [c._asdict() for c in costs], "growth_in_states": exponents}
        print(json.dumps(table, indent=1))
    else:
        print("| % of a core, least (median) | " + " | ".join(f"{cells} cells" for cells in CELLS) + " |")
        print("|---|" + "---|" * len(CELLS))
        for curve in CURVES:
            row = [c for c in costs if c.curve == curve.name]
            print(f"| {curve.name} | " + " | ".join(f"{100 * c.least:.2f} ({100 * c.median:.2f})" for c in row) + " |")
        powers = ", ".join(f"{between} {power:.2f}" for between, power in exponents.items())
        print(f"\n{CURVES[0].name}: grows with the power of the number of states: {powers}")
    if options.out is not None:
        draw(options.out, costs, options.sensors)


if __name__ == "__main__":
    main()
