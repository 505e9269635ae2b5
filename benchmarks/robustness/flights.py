"""Flights of the robustness table: each is one vehicle, task, case, law and start."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.batch import decode, keep_each
from benchmarks.robustness.cases import conditions
from benchmarks.robustness.laws import Gains, pilot
from benchmarks.strangers.flight import Conditions, Flight, Start, fly, load
from benchmarks.strangers.tasks import SETTLING_S, TASKS, Figures, Task, figures, mean_figures, speed_mps
from services.run.provenance import provenance_table
from services.tools.batch.results_store import open_store
from services.tools.campaign.trial import version_of

TASK_NAMES = ("hold", "square")
FAR_M = 1000.0
"""Largest error that counts: a law that goes round in circles or flies away has this or less."""


class Row(NamedTuple):
    """Row of the table."""

    vehicle: str
    task: str
    case: str


class Job(NamedTuple):
    """One flight."""

    row: Row
    law: str
    seed: int
    gains: Gains


def task_of(vehicle: str, name: str) -> Task:
    """Return a task with a duration that suits the vehicle's speed."""
    task, top_mps = TASKS[name], load(vehicle)[0].top_speed_mps()
    if len(task.targets[0][1]) == 1:
        return task._replace(duration_s=float(round(80.0 + 50.0 / top_mps)))
    corners = np.array(task.targets[0][1])
    length_m = float(np.hypot(*np.diff(corners, axis=0).T).sum())
    return task._replace(duration_s=float(round(40.0 + 1.4 * length_m / speed_mps(vehicle))), ahead_deg=0.0)


def flown(job: Job, task: Task, of: Conditions) -> Flight:
    """Fly a job's task under the conditions; LQR knows the steady current."""
    _, vehicle = load(job.row.vehicle)
    start = Start.drawn(job.seed, task.within_m)
    if task.ahead_deg is not None:
        start = start._replace(heading_rad=math.radians(task.ahead_deg))
    c = of.current_mps * math.cos(start.current_rad), of.current_mps * math.sin(start.current_rad)
    law = pilot(job.law, vehicle, task.targets[0][1], speed_mps(job.row.vehicle), c, job.gains)
    return fly(job.row.vehicle, law, of, start, duration_s=task.duration_s)


def judged(job: Job, share: float = 1.0) -> Figures:
    """Return the figures of a flight, without its first seconds; ``share``: of the task's duration that is flown."""
    hull, whole = load(job.row.vehicle)[0], task_of(job.row.vehicle, job.row.task)
    of, task = conditions(job.row.case, hull), whole._replace(duration_s=share * whole.duration_s)
    flight = flown(job, task, of)
    settled = flight.t_s >= SETTLING_S
    needed_N, arrays = flight.needed_N, (array[settled] for array in flight[:-1])
    found = figures(task, Flight(*arrays, needed_N), of, hull.max_N)
    return found._replace(mean_m=min(found.mean_m, FAR_M), max_m=min(found.max_m, FAR_M))


def run(
    rows: Sequence[Row], laws: Sequence[str], gains: dict[str, Gains], starts: int, workers: int | None, folder: Path
) -> dict[Row, dict[str, Figures]]:
    """Fly the rows that the folder does not have yet; return the figures by law, means over the starts."""
    jobs = {
        (row, law, seed): Job(row, law, seed, gains[row.vehicle])
        for row in rows
        for law in laws
        for seed in range(1, starts + 1)
    }
    keys = {key: f"{' '.join(key[0])} {key[1]} {key[2]}" for key in jobs}
    with open_store(folder, {"benchmark": "robustness", "version": version_of(provenance_table())}) as store:
        keep_each(judged, {keys[key]: job for key, job in jobs.items()}, store, workers=workers)
        kept = dict(store.results())

    def flown(row: Row, law: str) -> Figures:
        return mean_figures([decode(kept[keys[row, law, seed]], Figures) for seed in range(1, starts + 1)])

    return {row: {law: flown(row, law) for law in laws} for row in rows}
