"""Descents of the paper: one seed with the full loop, recorded for the figures, and many seeds with the state known."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from services.reporting.figures.renderer import Run
from services.reporting.plots.recorded import read
from services.run import folder
from services.run.run_config import Override, RunConfig, resolve
from services.tools import lockstep_run
from services.tools.batch.executor import run_each
from services.tools.batch.job import Job
from services.tools.paper.settings import AVERAGED, PERFECT_STATE, RECORDED, SCENARIO, Variant
from sim.evaluation.summary import Summary

SEED = 1
SURFACE_S = 30.0
"""Time afloat of the recorded descents: thirty TDCP fixes."""

AHEAD = ("horizon", "ahead")
"""Tables of the newest plan, which have no meaning for a run that has ended."""


class Flight(NamedTuple):
    """Recorded descent: its variant, folder and duration."""

    variant: Variant
    out: Path
    duration_s: float
    surface_s: float = SURFACE_S

    def run_config(self) -> RunConfig:
        """Resolve the settings of the run. Raises ``ConfigError``."""
        return resolve(
            SCENARIO,
            [
                Override("option --surface-s", [f"run.surface_time_s={self.surface_s!r}"]),
                Override("option --duration-s", [f"run.duration_s={self.duration_s!r}"]),
                Override("figures", [f"run.seed={SEED}", *self.variant.overrides]),
            ],
        )


def fly(flight: Flight) -> Summary:
    """Make the run and its folder; an existing folder is overwritten."""
    run_config = flight.run_config()
    return lockstep_run.run(run_config, folder.make(run_config.name, run_config.files, out=flight.out, force=True))


def recorded(
    runs: Path, duration_s: float, surface_s: float, *, workers: int | None, progress: Callable[[], None]
) -> dict[str, tuple[Run, Summary]]:
    """Return the plotted run and the summary of each recorded variant, by its key."""
    flights = [Flight(variant, runs / variant.key, duration_s, surface_s) for variant in RECORDED]
    summaries: dict[str, Summary] = {}
    for place, summary in run_each(fly, flights, workers=workers):
        summaries[flights[place].variant.key] = summary
        progress()
    return {
        flight.variant.key: (shown(flight, summaries[flight.variant.key]), summaries[flight.variant.key])
        for flight in flights
    }


def shown(flight: Flight, summary: Summary) -> Run:
    """Return the run in the form that figures draw."""
    picture = read(flight.out / folder.RECORDING)
    name = f"horizon {summary.horizon_s:.1f} s" if flight.variant.lateral else flight.variant.name
    past = {table: columns for table, columns in picture.tables.items() if table not in AHEAD}
    return Run(name, past, picture.values, picture.marks)


def averaged(
    seeds: int, duration_s: float, *, workers: int | None, progress: Callable[[], None]
) -> dict[str, list[Summary]]:
    """Return the summaries of seeds 0 to ``seeds`` - 1 of each averaged variant, by its key."""
    length = f"run.duration_s={duration_s!r}"
    jobs = [
        (variant.key, Job(SCENARIO, (f"run.seed={seed}", length, *PERFECT_STATE, *variant.overrides)))
        for variant in AVERAGED
        for seed in range(seeds)
    ]
    found: list[Summary | None] = [None] * len(jobs)
    for place, summary in run_each(Job.summary, [job for _, job in jobs], workers=workers):
        found[place] = summary
        progress()
    of: dict[str, list[Summary]] = {variant.key: [] for variant in AVERAGED}
    for (key, _), done in zip(jobs, found, strict=True):
        assert done is not None  # a job that raised has ended the batch
        of[key].append(done)
    return of


def count(seeds: int) -> int:
    """Return the number of recorded and averaged descents."""
    return len(RECORDED) + seeds * len(AVERAGED)
