"""Gains of the rival, tuned once for each hull under nominal conditions: ``python -m benchmarks.strangers tune``.

The search is that of all rivals (``benchmarks/rivals/search.py``). The cost at a point is the mean distance over the
whole flight, and along a line the mean distance from it plus the share of the time beyond what the speed needs; both
with the mean |F| over the largest thrust, so that gains that only chatter do not win.
"""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.rivals import pid
from benchmarks.rivals.search import search
from benchmarks.strangers.flight import FOREIGN, Conditions, Start, fly, load
from benchmarks.strangers.rival import PATH_SPANS
from benchmarks.strangers.tasks import SPEEDS_MPS, TASKS, figures, make_pilot
from services.tools.batch.executor import run_each

FILE = Path(__file__).parent / "gains.toml"
BUDGET, SEEDS = 64, (300, 301)
ANY_POINT = {"kp": 50.0, "kd": 100.0, "ki": 0.1, "k_psi": 50.0, "k_r": 50.0, "hold_N": 1.0}


class _Job(NamedTuple):
    hull: str
    gains: dict[str, dict[str, float]]
    task: str
    seed: int


def _cost(job: _Job) -> float:
    hull, task = load(job.hull)[0], TASKS[job.task]
    pilot = make_pilot(job.hull, task, job.gains)
    flight = fly(job.hull, pilot, Conditions(), Start.drawn(job.seed, task.within_m), duration_s=task.duration_s)
    force = float(np.abs(flight.track[:, -2:]).mean()) / hull.max_N
    if job.task == "hold":
        return float(flight.distance_m(task.targets[0][1][0], 0.0, task.duration_s).mean()) + force
    found = figures(task, flight, Conditions(), hull.max_N)
    needed_s = 20.0 / SPEEDS_MPS[job.hull]
    return found.mean_m + max(0.0, min(found.arrival_s, task.duration_s) / needed_s - 1.0) + force


def tune(jobs: int | None = None) -> None:
    """Tune all hulls and write the gains."""
    lines = [
        "# Gains of the rival, made by `python -m benchmarks.strangers tune`: "
        f"{BUDGET} trials for points and for paths of each hull."
    ]
    for name in FOREIGN:
        gains = {"point": ANY_POINT}
        for kind, task, spans in (("point", "hold", pid.SPANS), ("path", "line", PATH_SPANS)):

            def costs(
                trials: Sequence[dict[str, float]], kind: str = kind, task: str = task, name: str = name
            ) -> list[float]:
                todo = [_Job(name, {**gains, kind: trial}, task, seed) for trial in trials for seed in SEEDS]  # noqa: B023
                found = dict(run_each(_cost, todo, workers=jobs))
                return np.array([found[i] for i in range(len(todo))]).reshape(len(trials), -1).mean(axis=1).tolist()

            best = search(spans, costs, budget=BUDGET, seed=1)
            gains[kind] = best.values
            lines += ["", f"[{name}.{kind}]  # cost {best.cost:.3f}"]
            lines += [f"{key} = {value:.4g}" for key, value in best.values.items()]
    FILE.write_text("\n".join(lines) + "\n")


def gains_of(hull: str) -> dict[str, dict[str, float]]:
    """Return the tuned gains of a hull: of points and of paths."""
    gains: dict[str, dict[str, float]] = tomllib.loads(FILE.read_text())[hull]
    return gains
