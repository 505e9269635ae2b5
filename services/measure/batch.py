"""Many runs in lock step, on all cores: one engine for every table that needs more than one run."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import NamedTuple

from services.run import locked
from services.run.situation import Override, resolve
from sim.grading.summary import Summary


class Job(NamedTuple):
    """One run: a scenario's NAME or FILE, and settings on top of it, each KEY=VALUE."""

    scenario: str
    settings: tuple[str, ...]


def one(job: Job) -> Summary:
    """Run it here. Raises ``ConfigError``."""
    return locked.run(resolve(job.scenario, [Override("batch", job.settings)]))


def run(jobs: Sequence[Job], *, workers: int | None = None) -> Iterator[tuple[int, Summary]]:
    """Each job's place in ``jobs`` and its summary, as they end. Raises what a run raised."""
    # spawn: a forked child would inherit threads of BLAS and of a bus session
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers or os.cpu_count(), mp_context=context) as pool:
        places = {pool.submit(one, job): i for i, job in enumerate(jobs)}
        for future in as_completed(places):
            yield places[future], future.result()
