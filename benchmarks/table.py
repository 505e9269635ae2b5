"""Table of means over seeds: one row for each setting, with the same seeds for all."""

from __future__ import annotations

import argparse
import json
import statistics
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.progress import Progress

from benchmarks.loop import Outcome
from services.tools.batch.executor import run_each


class Figures(NamedTuple):
    """Figures of one run."""

    mean_m: float
    late_m: float  # mean of the second half
    max_m: float
    mean_abs_N: float
    saturated: float

    @classmethod
    def of(cls, outcome: Outcome) -> Figures:
        """Extract the figures of a run."""
        late = outcome.distance_m[len(outcome.distance_m) // 2 :]
        return cls(outcome.mean_m, float(late.mean()), outcome.max_m, outcome.mean_abs_N, outcome.saturated)


class Job(NamedTuple):
    """One run: its row, and its seed."""

    row: str
    seed: int


def measure(description: str | None, rows: Sequence[str], one: Callable[[Job], Figures]) -> None:
    """Command line, runs, table. ``one`` is a function of a module: it is pickled."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--only", help="rows that have this in their name")
    parser.add_argument("--workers", type=int)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    rows = [row for row in rows if options.only is None or options.only in row]
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    jobs = [Job(row, seed) for row in rows for seed in seeds]
    found: dict[str, dict[int, Figures]] = {row: {} for row in rows}
    with Progress(console=Console(stderr=True)) as progress:
        task = progress.add_task(f"{len(jobs)} runs", total=len(jobs))
        for place, figures in run_each(one, jobs, workers=options.workers):
            row, seed = jobs[place]
            found[row][seed] = figures
            progress.advance(task)
            if len(found[row]) == len(seeds):
                progress.console.print(text(row, list(found[row].values())), markup=False, soft_wrap=True)
    names = f"seeds {seeds.start} to {seeds.stop - 1}"
    print(f"| {names} | mean (m) | second half (m) | worst seed (m) | largest (m) | mean abs F (N) | saturated (%) |")
    print("|---|---|---|---|---|---|---|")
    for row in rows:
        print(text(row, list(found[row].values())))
    if options.out is not None:
        kept = {row: {seed: f._asdict() for seed, f in sorted(runs.items())} for row, runs in found.items()}
        options.out.write_text(json.dumps(kept, indent=1) + "\n")


def text(row: str, runs: Sequence[Figures]) -> str:
    """Format a row of the table."""
    mean = Figures(*(statistics.fmean(column) for column in zip(*runs, strict=True)))
    worst = max(run.mean_m for run in runs)
    largest = float(np.max([run.max_m for run in runs]))
    return (
        f"| {row} | {mean.mean_m:.4f} | {mean.late_m:.4f} | {worst:.3f} | {largest:.2f} | {mean.mean_abs_N:.1f} "
        f"| {100 * mean.saturated:.2f} |"
    )
