"""Many runs of a benchmark on this machine's cores, with a progress bar; a lock-step run as a job of them.

Results with arrays are kept as lists in a store; ``decode`` makes arrays of them again.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, TypeVar, get_args

import msgspec
import numpy as np

from services.reporting.terminal import progress_bar
from services.run.run_config import Override, RunConfig, resolve
from services.tools import lockstep_run
from services.tools.batch import executor
from services.tools.batch.executor import run_each
from services.tools.batch.results_store import ResultsStore
from sim.evaluation.summary import Summary

T = TypeVar("T")
R = TypeVar("R")


class Job(NamedTuple):
    """Run of a scenario (NAME or FILE) with settings, each KEY=VALUE."""

    scenario: str
    settings: tuple[str, ...]

    def run_config(self) -> RunConfig:
        """Resolve what the run is made of. Raises ``ConfigError``."""
        return resolve(self.scenario, [Override("batch", self.settings)])

    def summary(self) -> Summary:
        """Run it here, in lock step. Raises ``ConfigError``."""
        return lockstep_run.run(self.run_config())


def in_order(work: Callable[[T], R], jobs: Sequence[T], *, workers: int | None = None) -> list[R]:
    """Do all jobs, on so many processes (None: one a core); return their results in the order of the jobs."""
    with progress_bar(f"{len(jobs)} runs") as progress:
        return executor.in_order(work, jobs, workers=workers, progress=progress)


def keep_each(
    work: Callable[[T], object],
    jobs: Mapping[str, T],
    store: ResultsStore,
    *,
    workers: int | None = None,
) -> None:
    """Do the jobs that the store does not have by their keys, and append their results as they end."""
    missing = {key: job for key, job in jobs.items() if key not in store.keys}
    keys, done = list(missing), len(jobs) - len(missing)
    with progress_bar(f"{len(jobs)} runs") as progress:
        for place, result in run_each(work, list(missing.values()), workers=workers):
            store.append(keys[place], as_plain(result))
            done += 1
            progress(done / len(jobs))


def as_plain(result: Any) -> Any:
    """Return a result as plain values, an array as a list."""
    return msgspec.to_builtins(result, enc_hook=lambda array: array.tolist())


def decode(plain: Any, kind: type[R]) -> R:
    """Return plain values of a store as the result of type ``kind`` that they were."""
    return msgspec.convert(plain, kind, dec_hook=lambda of, value: np.array(value, dtype=get_args(get_args(of)[1])[0]))
