"""Simulated descents of the paper's comparison.

For the figures, one seed runs with localisation and is recorded. For a table, many seeds run with the true state
(``PERFECT_STATE``) and are averaged: this shows the controller alone.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from benchmarks.paper.settings import AVERAGED, DEMO, PERFECT_STATE, README, RECORDED, SCENARIO, Variant
from services.reporting.figures.renderer import Run
from services.reporting.plots.recorded import read
from services.run import folder
from services.run.run_config import Override, RunConfig, resolve
from services.tools import lockstep_run
from services.tools.batch.executor import run_each
from services.tools.batch.job import Job
from sim.evaluation.summary import Summary

SEED = 1
"""Seed of the recorded descents of the paper; the demo has its own."""

SURFACE_S = 30.0
"""Time at the surface before a recorded descent (s): thirty TDCP fixes, one a second."""

FUTURE_TABLES = ("horizon", "ahead")
"""Plotted tables of the newest plan's prediction. The figures of a finished run do not show them."""


class RecordedDescent(NamedTuple):
    """Descent that is recorded for the figures."""

    variant: Variant
    out: Path  # folder of the run
    duration_s: float
    surface_s: float = SURFACE_S

    def run_config(self) -> RunConfig:
        """Return the settings of the run. Raises ``ConfigError``."""
        of_demo = self.variant in README
        seed = () if of_demo else (f"run.seed={SEED}",)
        return resolve(
            DEMO if of_demo else SCENARIO,
            [
                Override("option --surface-s", [f"run.surface_time_s={self.surface_s!r}"]),
                Override("option --duration-s", [f"run.duration_s={self.duration_s!r}"]),
                Override("figures", [*seed, *self.variant.overrides]),
            ],
        )


def run_descent(descent: RecordedDescent) -> Summary:
    """Simulate a descent in lock step and record it; the files of an earlier run in its folder are replaced."""
    run_config = descent.run_config()
    return lockstep_run.run(run_config, folder.make(run_config.name, run_config.files, out=descent.out, force=True))


def recorded(
    runs: Path, duration_s: float, surface_s: float, *, workers: int | None, progress: Callable[[], None]
) -> dict[str, tuple[Run, Summary]]:
    """Run the descent of each recorded variant; return its plotted run and its summary, by the variant's key.

    Parameters
    ----------
    runs : folder with one run folder for each variant.
    duration_s, surface_s : duration of a descent, and time at the surface before it (s).
    workers : number of processes; one a core if None.
    progress : called after each descent.
    """
    variants = (*RECORDED, *README)
    descents = [RecordedDescent(variant, runs / variant.key, duration_s, surface_s) for variant in variants]
    summaries: dict[str, Summary] = {}
    for index, summary in run_each(run_descent, descents, workers=workers):
        summaries[descents[index].variant.key] = summary
        progress()
    return {
        descent.variant.key: (plotted_run(descent, summaries[descent.variant.key]), summaries[descent.variant.key])
        for descent in descents
    }


def plotted_run(descent: RecordedDescent, summary: Summary) -> Run:
    """Return the recorded run in the form that figures draw, without the tables of the newest plan."""
    plotted = read(descent.out / folder.RECORDING)
    name = f"horizon {summary.horizon_s:.1f} s" if descent.variant.lateral else descent.variant.name
    past = {table: columns for table, columns in plotted.tables.items() if table not in FUTURE_TABLES}
    return Run(name, past, plotted.values, plotted.marks)


def averaged(
    seeds: int, duration_s: float, *, workers: int | None, progress: Callable[[], None]
) -> dict[str, list[Summary]]:
    """Run seeds 0 to ``seeds`` - 1 of each averaged variant; return their summaries, by the variant's key.

    Parameters
    ----------
    seeds : number of seeds of each variant.
    duration_s : duration of a descent (s).
    workers : number of processes; one a core if None.
    progress : called after each descent.
    """
    duration = f"run.duration_s={duration_s!r}"
    jobs = [
        (variant.key, Job(SCENARIO, (f"run.seed={seed}", duration, *PERFECT_STATE, *variant.overrides)))
        for variant in AVERAGED
        for seed in range(seeds)
    ]
    summaries: list[Summary | None] = [None] * len(jobs)
    for index, job_summary in run_each(Job.summary, [job for _, job in jobs], workers=workers):
        summaries[index] = job_summary
        progress()
    by_key: dict[str, list[Summary]] = {variant.key: [] for variant in AVERAGED}
    for (key, _), summary in zip(jobs, summaries, strict=True):
        assert summary is not None  # an exception of a job would have ended the batch
        by_key[key].append(summary)
    return by_key


def count(seeds: int) -> int:
    """Return the number of descents, recorded and averaged, with this number of seeds for each averaged variant."""
    return len(RECORDED) + len(README) + seeds * len(AVERAGED)
