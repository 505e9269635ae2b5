"""Against what people use instead, and the worth of each part: one table, paired by seed.

    .venv/bin/python -m benchmarks.rivals --out DIR [--only TEXT] [--budget N] [--seeds N] [--workers N]

The paper's descent with the state known. Every row that has something to tune is tuned by the same search
(``search.py``) of --budget trials (64), each the mean distance over the first 60 s of four seeds that are in no table;
then it flies --seeds (100) seeds that nothing was tuned on, 200 s each. The controller has its default horizon and
effort. Rows that DIR has already are not done again; --only names those to do now. The energy is that of the two
lateral propellers.
"""

from __future__ import annotations

import argparse
import functools
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from rich.console import Console
from rich.progress import Progress

from benchmarks.loop import Outcome, run_config
from benchmarks.rivals import law, lqr, mpc, pid
from benchmarks.rivals.search import Span, search
from services.run.provenance import provenance_table
from services.tools.batch.executor import run_each
from services.tools.batch.results_store import open_store
from services.tools.campaign.ranking import interval
from services.tools.campaign.trial import version_of

TUNED_ON, TUNED_S = range(300, 304), 60.0
FIRST_SEED = 400
DELAY_S = 0.71
"""Delay of the paper's cycle at a horizon of 5 s."""


class Row(NamedTuple):
    """One line of the table; without ``spans`` there is nothing to tune."""

    kind: str  # nothing, pid, lqr or mpc
    spans: dict[str, Span]
    variant: mpc.Variant = mpc.Variant()


WHOLE = "this controller, default weights"
ROWS = {
    "nothing": Row("nothing", {}),
    "PID with heading": Row("pid", pid.SPANS),
    "LQR, told the water here": Row("lqr", lqr.SPANS),
    "MPC without any water": Row("mpc", mpc.SPANS, mpc.Variant(told_of_water=False, estimates_water=False)),
    "MPC, water as a disturbance": Row("mpc", mpc.SPANS, mpc.Variant(told_of_water=False)),
    "MPC without preview": Row("mpc", mpc.SPANS, mpc.Variant(preview=False)),
    "MPC, 0.71 s, not compensated": Row("mpc", mpc.SPANS, mpc.Variant(delay_s=DELAY_S, compensates=False)),
    "MPC, 0.71 s": Row("mpc", mpc.SPANS, mpc.Variant(delay_s=DELAY_S)),
    "this controller, tuned as the others": Row("mpc", mpc.SPANS),
    WHOLE: Row("mpc", {}),
}


class Job(NamedTuple):
    """One run."""

    row: str
    values: dict[str, float]
    seed: int
    duration_s: float


Figures: TypeAlias = tuple[float, float, float, float]
"""Mean distance (m), mean |F| (N), largest distance (m), lateral propulsive energy (J)."""


def one(job: Job) -> Figures:
    """Return the figures of a run; NaN for weights of which no gain comes."""
    try:
        outcome = flown(job)
    except np.linalg.LinAlgError:
        return math.nan, math.nan, math.nan, math.nan
    return outcome.mean_m, outcome.mean_abs_N, outcome.max_m, outcome.lateral_energy_J


def flown(job: Job) -> Outcome:
    """Make the run."""
    row = ROWS[job.row]
    weights = [f"controller.weights.{key}={value!r}" for key, value in job.values.items()] if row.kind == "mpc" else []
    here = run_config(f"run.seed={job.seed}", f"run.duration_s={job.duration_s}", *row.variant.settings, *weights)
    if row.kind == "mpc":
        return mpc.fly(here, row.variant)
    if row.kind == "pid":
        return law.fly(here, pid.Pid(here.vehicle, job.values))
    return law.fly(here, lqr.Lqr(here.vehicle, job.values) if row.kind == "lqr" else law.Nothing())


def costs(name: str, run: Callable[[list[Job]], list[Any]], trials: Sequence[dict[str, float]]) -> list[float]:
    """Mean distance (m) of each trial over the tuning seeds."""
    jobs = [Job(name, trial, seed, TUNED_S) for trial in trials for seed in TUNED_ON]
    means = np.array([figures[0] for figures in run(jobs)]).reshape(len(trials), -1)
    return [float(cost) for cost in means.mean(axis=1)]


def main() -> None:
    """Tune, fly, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--only", default="", help="do the rows with this text in their name")
    parser.add_argument("--budget", type=int, default=64)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--workers", type=int)
    options = parser.parse_args()
    settings = {"budget": options.budget, "seeds": options.seeds, "version": version_of(provenance_table())}
    console = Console(stderr=True)
    with open_store(options.out, settings) as store:
        for name in (name for name in ROWS if name not in store.keys and options.only in name):
            values: dict[str, float] = {}
            history: list[float] = []
            with Progress(console=console) as progress:
                run = functools.partial(_runs, progress, name, options.workers)
                if spans := ROWS[name].spans:
                    values, _, history = search(
                        spans, functools.partial(costs, name, run), budget=options.budget, seed=1
                    )
                seeds = range(FIRST_SEED, FIRST_SEED + options.seeds)
                figures = run([Job(name, values, seed, 200.0) for seed in seeds])
            store.append(name, {"values": values, "history_m": history, "runs": figures})
        rows = dict(store.results())
    if WHOLE in rows:
        print(table({name: rows[name] for name in ROWS if name in rows}))


def _runs(progress: Progress, name: str, workers: int | None, jobs: list[Job]) -> list[Figures]:
    task = progress.add_task(f"{name}: {len(jobs)} runs", total=len(jobs))
    found: dict[int, Figures] = {}
    for place, figures in run_each(one, jobs, workers=workers):
        found[place] = figures
        progress.advance(task)
    progress.remove_task(task)
    return [found[place] for place in range(len(jobs))]


def table(kept: dict[str, Any]) -> str:
    """Return the table of means over seeds, with differences to the whole controller and their 95 % interval."""
    whole = np.array(kept[WHOLE]["runs"])
    lines = [
        f"| mean of {len(whole)} seeds | distance (m) | more than whole (m) | largest (m) | abs F (N) | energy (kJ) "
        "| trials' best |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, of in kept.items():
        runs = np.array(of["runs"])
        more = interval(runs[:, 0] - whole[:, 0])
        said = "" if name == WHOLE else f"{more.mean:.3f} ({more.low:.3f} to {more.high:.3f})"
        history = of["history_m"]
        half = "" if not history else f"{history[len(history) // 2 - 1]:.3f}, {history[-1]:.3f} m"
        distance, force, largest = runs[:, 0].mean(), runs[:, 1].mean(), runs[:, 2].max()
        energy_kJ = 1e-3 * runs[:, 3].mean()
        lines.append(f"| {name} | {distance:.3f} | {said} | {largest:.2f} | {force:.1f} | {energy_kJ:.2f} | {half} |")
    return "\n".join(lines)
