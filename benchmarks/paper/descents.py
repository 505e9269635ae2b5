"""Recorded descents of the paper's comparison: one seed of each variant, in lock step."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from benchmarks.batch import in_order
from benchmarks.paper.renderer import Run
from benchmarks.paper.settings import README, RECORDED, Variant
from services.reporting.plots.recorded import read
from services.run import folder
from services.run.run_config import Override, RunConfig, resolve
from services.tools import lockstep_run
from sim.evaluation.summary import Summary

SEED = 3
"""Seed of the recorded descents of the paper; the demo has its own."""

FUTURE_TABLES = ("horizon", "ahead")
"""Plotted tables of the newest plan's prediction. The figures of a finished run do not show them."""


class RecordedDescent(NamedTuple):
    """Descent that is recorded for the figures."""

    variant: Variant
    out: Path  # folder of the run
    duration_s: float

    def run_config(self) -> RunConfig:
        """Return the settings of the run. Raises ``ConfigError``."""
        seed = () if self.variant in README else (f"run.seed={SEED}",)
        return resolve(
            self.variant.scenario,
            [
                Override("option --duration-s", [f"run.duration_s={self.duration_s!r}"]),
                Override("figures", [*seed, *self.variant.overrides]),
            ],
        )


def run_descent(descent: RecordedDescent) -> Summary:
    """Simulate a descent in lock step and record it; the files of an earlier run in its folder are replaced."""
    run_config = descent.run_config()
    return lockstep_run.run(run_config, folder.make(run_config.name, run_config.files, out=descent.out, force=True))


def recorded(runs: Path, duration_s: float, *, workers: int | None) -> dict[str, tuple[Run, Summary]]:
    """Run the descent of each recorded variant; return its plotted run and its summary, by the variant's key.

    Parameters
    ----------
    runs : folder with one run folder for each variant.
    duration_s : duration of a descent (s).
    workers : number of processes; one a core if None.
    """
    descents = [RecordedDescent(variant, runs / variant.key, duration_s) for variant in (*RECORDED, *README)]
    summaries = in_order(run_descent, descents, workers=workers)
    return {
        one.variant.key: (plotted_run(one, summary), summary) for one, summary in zip(descents, summaries, strict=True)
    }


def plotted_run(descent: RecordedDescent, summary: Summary) -> Run:
    """Return the recorded run in the form that figures draw, without the tables of the newest plan."""
    plotted = read(descent.out / folder.RECORDING)
    name = f"horizon {summary.horizon_s:.1f} s" if descent.variant.lateral else descent.variant.name
    past = {table: columns for table, columns in plotted.tables.items() if table not in FUTURE_TABLES}
    return from_line(Run(name, past, plotted.values, plotted.marks))


def from_line(run: Run) -> Run:
    """Return the run with north and east from the line, which begins at the estimate at t = 0."""
    tables = dict(run.tables)
    track = tables["track"]
    first = next(i for i, t in enumerate(track["t_s"]) if t is not None and t >= 0.0)
    start = {name: track[name][first] or 0.0 for name in ("north_m", "east_m")}
    for table in ("track", "truth", "reference"):
        moved = {name: [None if x is None else x - at for x in tables[table][name]] for name, at in start.items()}
        tables[table] = tables[table] | moved
    return run._replace(tables=tables)
