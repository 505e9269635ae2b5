"""What localisation costs against the number of water cells: seconds of processor time per second of vehicle time.

    .venv/bin/python -m benchmarks.localisation [--json] [--out FILE.png] [--repeats N] [--sensors NAME]

One simulated descent is heard by estimators that differ in their cells alone, each message through the node's own
``step``: alignment, inertial samples, corrections, the history for late messages and ten estimates a second. Processor
time, not wall time; settings take turns, N times (9), since the machine may be shared: the least is the cost, the
median says how much of it the others took.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
from rich.console import Console
from rich.progress import Progress

from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.estimator import Estimator
from ltv_mpc.localisation.suite import Suite
from ltv_mpc.node import Arrival, Inbox
from services.measure.batch import Job
from services.run import locked
from sim.lockstep import Cause, LockStep

CELLS = (25, 50, 70, 140, 280, 500)
DESCENT_S = 60.0
BEHIND_M = {"every cell kept": 2000.0, "70 m behind kept (default)": 70.0, "none behind kept": 0.0}
"""``kept_m`` of each curve."""

LIMITS = {70: 0.005, 500: 0.10}
"""Share of a core, of the first curve."""

COLOURS = ("#0072B2", "#E69F00", "#009E73")
MARKERS = ("o", "s", "^")


class Setting(NamedTuple):
    """One point of one curve."""

    curve: str
    cells: int


class Cost(NamedTuple):
    """Of one setting. Shares of a core."""

    states: int
    least: float
    median: float


class Heard:
    """What an estimator is handed, step by step."""

    def __init__(self) -> None:
        self.steps: list[tuple[int, Inbox]] = []

    def stepped(self, at_ns: int, node: str, number: int, t_ns: int, cause: Cause, inbox: Inbox) -> None:  # noqa: ARG002
        if node == Estimator.name:
            self.steps.append((t_ns, list(inbox)))

    def published(self, node: str, message: Arrival) -> None:
        pass


def record(sensors: str) -> tuple[Suite, list[tuple[int, Inbox]], float]:
    """The sensors, what the estimator of a descent is handed, and over how many seconds."""
    situation = Job("descent", (f'sensors="{sensors}"', f"run.duration_s={DESCENT_S}")).situation()
    scenario, heard = situation.scenario, Heard()
    LockStep(locked.nodes(situation), start_ns=scenario.start_ns, observe=heard, latest=locked.LATEST).advance(
        scenario.end_ns
    )
    return situation.suite, heard.steps, (scenario.end_ns - scenario.start_ns) * 1e-9


def measure(suite: Suite, steps: list[tuple[int, Inbox]], seconds: float, setting: Setting) -> tuple[int, float]:
    """Number of states and share of a core of one pass."""
    config = msgspec.structs.replace(EstimatorConfig(), deepest_m=float(setting.cells), kept_m=BEHIND_M[setting.curve])
    estimator = Estimator(suite, config)
    began = time.process_time()
    for t_ns, inbox in steps:
        estimator.step(t_ns, inbox)
    spent = time.process_time() - began
    if estimator.filter is None:
        raise RuntimeError("the descent has not been long enough to align")
    return estimator.filter.belief.layout.size, spent / seconds


def growth(cells: Sequence[int], costs: Sequence[Cost]) -> dict[str, float]:
    """Exponent of the cost in the number of states, between each setting and the next."""
    states = [cost.states for cost in costs]
    return {
        f"{cells[i]} to {cells[i + 1]} cells": float(
            np.log(costs[i + 1].least / costs[i].least) / np.log(states[i + 1] / states[i])
        )
        for i in range(len(costs) - 1)
        if states[i + 1] > states[i]
    }


def draw(path: Path, results: dict[Setting, Cost], sensors: str) -> None:
    """Share of a core against cells, both logarithmic."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7.5, 5.0), layout="constrained")
    for curve, colour, marker in zip(BEHIND_M, COLOURS, MARKERS, strict=True):
        share = [100 * results[Setting(curve, cells)].least for cells in CELLS]
        axes.loglog(CELLS, share, color=colour, marker=marker, markersize=7, linewidth=1.8, label=curve)
    last = 100 * results[Setting("every cell kept", CELLS[-1])].least
    reach = np.array([150.0, CELLS[-1]])
    axes.loglog(
        reach, last * (reach / CELLS[-1]) ** 2, color="#555555", linestyle=":", label="as the square of the cells"
    )
    for cells, limit in LIMITS.items():
        axes.plot(cells, 100 * limit, marker="_", color="#D55E00", markersize=26, markeredgewidth=2.5, linestyle="none")
        axes.annotate(
            f"at most {100 * limit:g} %", (cells, 100 * limit), xytext=(14, 6), textcoords="offset points", ha="right"
        )
    axes.set_xticks(CELLS, [str(cells) for cells in CELLS])
    ticks = [0.1, 0.2, 0.5, 1, 2, 5, 10]
    axes.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.minorticks_off()
    axes.set_xlim(22, 570)
    axes.set_ylim(0.08, 16)
    axes.set_xlabel("water cells of 1 m in the grid")
    axes.set_ylabel("processor time, % of one core at real time")
    axes.set_title(f"Localisation, sensors {sensors}: 3 profiles of 120 beam cells a second", fontsize=11)
    axes.grid(which="major", color="#dddddd", linewidth=0.7)
    axes.legend(loc="upper left", frameon=False)
    figure.savefig(path, dpi=150)
    plt.close(figure)


def main() -> None:
    """Measure, print, and draw where asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument("--sensors", default="paper")
    options = parser.parse_args()
    suite, steps, seconds = record(options.sensors)
    settings = [Setting(curve, cells) for curve in BEHIND_M for cells in CELLS]
    measure(suite, steps[: len(steps) // 4], seconds, settings[0])  # compiles
    spent: dict[Setting, list[float]] = {setting: [] for setting in settings}
    states: dict[Setting, int] = {}
    with Progress(console=Console(stderr=True)) as progress:
        task = progress.add_task("passes", total=options.repeats * len(settings))
        for _ in range(options.repeats):
            for setting in settings:
                states[setting], share = measure(suite, steps, seconds, setting)
                spent[setting].append(share)
                progress.advance(task)
    results = {s: Cost(states[s], min(spent[s]), statistics.median(spent[s])) for s in settings}
    exponents = growth(CELLS, [results[Setting("every cell kept", cells)] for cells in CELLS])
    if options.json:
        table = [{**setting._asdict(), **results[setting]._asdict()} for setting in settings]
        print(
            json.dumps({"sensors": options.sensors, "share_of_a_core": table, "growth_in_states": exponents}, indent=1)
        )
    else:
        print("| cells | " + " | ".join(f"{curve}: states | least (%) | median (%)" for curve in BEHIND_M) + " |")
        print("|---|" + "---|" * (3 * len(BEHIND_M)))
        for cells in CELLS:
            row = [results[Setting(curve, cells)] for curve in BEHIND_M]
            text = " | ".join(f"{c.states} | {100 * c.least:.3f} | {100 * c.median:.3f}" for c in row)
            print(f"| {cells} | {text} |")
        print("\ncost grows with the states as their power: " + ", ".join(f"{k} {v:.2f}" for k, v in exponents.items()))
    if options.out is not None:
        draw(options.out, results, options.sensors)


if __name__ == "__main__":
    main()
