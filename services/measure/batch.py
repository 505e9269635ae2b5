"""Many runs on all cores: one engine for every table that needs more than one run.

A job is whatever its work can be done with; work and jobs are pickled, so the work is a function of a module.
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import NamedTuple, TypeVar

from services.launch.orphans import die_with_parent
from services.run import locked
from services.run.situation import Override, Situation, resolve
from sim.grading.summary import Summary

T = TypeVar("T")
R = TypeVar("R")


def each(work: Callable[[T], R], jobs: Sequence[T], *, workers: int | None = None) -> Iterator[tuple[int, R]]:
    """Each job's place in ``jobs`` and what came of it, as they end. Raises what a job raised, and starts no more.

    ``workers``: processes; None: as many as there are cores. With one, the work is done in this process.
    """
    count = min(len(jobs), workers or os.cpu_count() or 1)
    if count <= 1:
        yield from ((i, work(job)) for i, job in enumerate(jobs))
        return
    with pool(count) as workers_:
        places = {workers_.submit(work, job): i for i, job in enumerate(jobs)}
        try:
            for future in as_completed(places):
                yield places[future], future.result()
        except BaseException:  # a job that raised, or a reader that has gone: what has not begun is not begun
            workers_.shutdown(wait=False, cancel_futures=True)
            raise


def pool(count: int) -> ProcessPoolExecutor:
    """So many processes, which end with this one however it ends."""
    # spawn: a forked child would inherit threads of BLAS and of a bus session
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(count, mp_context=context, initializer=die_with_parent, initargs=(os.getpid(),))


class Job(NamedTuple):
    """One run: a scenario's NAME or FILE, and settings on top of it, each KEY=VALUE."""

    scenario: str
    settings: tuple[str, ...]

    def situation(self) -> Situation:
        """What the run is made of. Raises ``ConfigError``."""
        return resolve(self.scenario, [Override("batch", self.settings)])


def one(job: Job) -> Summary:
    """Run it here, in lock step. Raises ``ConfigError``."""
    return locked.run(job.situation())


def run(jobs: Sequence[Job], *, workers: int | None = None) -> Iterator[tuple[int, Summary]]:
    """Each job's place in ``jobs`` and its summary, as they end."""
    return each(one, jobs, workers=workers)
