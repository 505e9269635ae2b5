"""Gains of the rivals, tuned once for each vehicle on the right file: ``python -m benchmarks.robustness --tune``.

The search is that of all rivals (``benchmarks/rivals/search.py``), with the same number of trials for each. PID has one
set of gains for points and one for paths, tuned on a point and on a line of 20 m; LQR has one, tuned on both. The cost
of a flight is the mean error, the time of arrival over the flight's, and the mean |F| over the largest thrust.
"""

from __future__ import annotations

import sys
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.rivals import lqr, pid
from benchmarks.rivals.search import search
from benchmarks.robustness.cases import RIGHT
from benchmarks.robustness.flights import Job, Row, judged, task_of
from benchmarks.robustness.laws import LQR, PID, Gains
from benchmarks.strangers.rival import PATH_SPANS
from services.tools.batch.executor import run_each

FILE = Path(__file__).parent / "gains.toml"
BUDGET, SEEDS = 64, (300, 301)
WORST = 1e3
ANY_POINT = {"kp": 50.0, "kd": 100.0, "ki": 0.1, "k_psi": 50.0, "k_r": 50.0, "hold_N": 1.0}
"""Gains at the end of a path while those of the path are tuned."""


class _Part(NamedTuple):
    """Set of gains that is tuned at once."""

    name: str
    law: str
    tasks: tuple[str, ...]


PARTS = {
    _Part("point", PID, ("hold",)): pid.SPANS,
    _Part("path", PID, ("line",)): PATH_SPANS,
    _Part("lqr", LQR, ("hold", "line")): lqr.SPANS,
}


def cost(job: Job) -> float:
    """Return the cost of a flight."""
    try:
        found = judged(job)
    except np.linalg.LinAlgError:
        return WORST
    task_s = task_of(job.row.vehicle, job.row.task).duration_s
    return found.mean_m + min(found.arrival_s, 2.0 * task_s) / task_s + found.force


def tuned(vehicle: str) -> Gains:
    """Return the gains of a vehicle's rivals."""
    found: Gains = {"point": ANY_POINT}
    for part, spans in PARTS.items():

        def costs(trials: Sequence[dict[str, float]], part: _Part = part) -> list[float]:
            rows = [Row(vehicle, task, RIGHT) for task in part.tasks]
            jobs = (
                [Job(row, part.law, seed, {**found, part.name: one}) for row in rows for seed in SEEDS]
                for one in trials
            )
            return [float(np.mean([cost(job) for job in of])) for of in jobs]

        best = search(spans, costs, budget=BUDGET, seed=1)
        found[part.name] = best.values
        print(f"{vehicle} {part.name}: cost {best.cost:.3f}", file=sys.stderr, flush=True)
    return found


def tune(vehicles: Sequence[str], jobs: int | None) -> None:
    """Tune the rivals of some vehicles, one a process; those of others in the file stay."""
    kept = gains() if FILE.exists() else {}
    for place, found in run_each(tuned, vehicles, workers=jobs):
        kept[vehicles[place]] = found
        lines = [f"# Made by `python -m benchmarks.robustness --tune`: {BUDGET} trials for each table."]
        for name in sorted(kept):
            for table, values in kept[name].items():
                lines += ["", f"[{name}.{table}]", *(f"{key} = {value:.4g}" for key, value in values.items())]
        FILE.write_text("\n".join(lines) + "\n")


def gains() -> dict[str, Gains]:
    """Return the tuned gains by vehicle."""
    found: dict[str, Gains] = tomllib.loads(FILE.read_text())
    return found
