"""Make the runs of the study on paired seeds, on all cores, and keep each result.

A study that is started again in the same folder, by the same sources (``version``), makes only the runs that are
missing.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.stats import t as student

from benchmarks.ablation.controller import MECHANISMS as OF_CONTROLLER
from benchmarks.ablation.estimator import MECHANISMS as OF_ESTIMATOR
from benchmarks.ablation.mechanism import Measures, Mechanism
from services.tools.batch.executor import run_each
from services.tools.batch.results_store import ResultsStore

MECHANISMS: tuple[Mechanism, ...] = (*OF_ESTIMATOR, *OF_CONTROLLER)

ROOT = Path(__file__).resolve().parents[2]

DETECTABLE = 2.8
"""Standard errors: an effect of this size is found with 80 % power at 5 % (1.96 + 0.84)."""


class Key(NamedTuple):
    """One run: of which event and seed, what is switched off ("": nothing), and for which mechanism it was timed."""

    event: str
    seed: int
    off: str
    timed_for: str


class Job(NamedTuple):
    """Runs that are made one after the other in one process."""

    mechanism: str
    event: str
    keys: tuple[Key, ...]


class Effect(NamedTuple):
    """One measure of a mechanism: means over the paired runs, and the difference without - with."""

    measure: str
    pairs: int
    with_it: float
    without: float
    worst_with: float  # largest of all runs
    worst_without: float
    difference: float
    half_width: float  # of the difference's 95 % interval
    detectable: float  # smallest difference that this number of runs can detect


def named(name: str, event: str) -> Mechanism:
    """Return the row of this mechanism and event. Raises KeyError."""
    return {(mechanism.name, mechanism.event.name): mechanism for mechanism in MECHANISMS}[name, event]


def version() -> str:
    """Return a hash of all sources that a run depends on."""
    digest = hashlib.sha256()
    for package in ("ltv_mpc", "sim", "services"):
        for path in sorted((ROOT / package).rglob("*")):
            if path.suffix in {".py", ".toml"}:
                digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def jobs(mechanisms: Sequence[Mechanism], seeds: Sequence[int], known: set[Key]) -> list[Job]:
    """Return what is still to be run. Seeds come first, so that an interrupted study has pairs of every mechanism."""
    todo: list[Job] = []
    planned = set(known)
    for seed in seeds:
        for mechanism in mechanisms:
            on, off = keys(mechanism, seed)
            if mechanism.timed:
                pair = (on, off) if seed % 2 else (off, on)
                groups = [] if set(pair) <= planned else [pair]
            else:
                groups = [(key,) for key in (on, off) if key not in planned]
            todo += [Job(mechanism.name, mechanism.event.name, group) for group in groups]
            planned.update(key for group in groups for key in group)
    return todo


def keys(mechanism: Mechanism, seed: int) -> tuple[Key, Key]:
    """Return the keys of the run with the mechanism and of that without."""
    timed_for = mechanism.name if mechanism.timed else ""
    event = mechanism.event.name
    return Key(event, seed, "", timed_for), Key(event, seed, mechanism.name, timed_for)


def make(job: Job) -> list[tuple[Key, Measures]]:
    """Make the runs of a job in this process."""
    mechanism = named(job.mechanism, job.event)
    if mechanism.timed:
        mechanism.event.run(job.keys[0].seed)  # compile, fill caches
    done = []
    for key in job.keys:
        with mechanism.off() if key.off else nullcontext():
            done.append((key, mechanism.event.run(key.seed)))
    return done


def run(todo: Sequence[Job], store: ResultsStore, workers: int | None) -> Iterator[int]:
    """Make all jobs, keep each result, and yield how many jobs are done."""
    for count, (_, done) in enumerate(run_each(make, todo, workers=workers), 1):
        for key, measures in done:
            store.append(json.dumps(key), measures)
        yield count


def load(store: ResultsStore) -> dict[Key, Measures]:
    """Read the results so far."""
    return {Key(*json.loads(key)): measures for key, measures in store.results()}


def effects(mechanism: Mechanism, seeds: Sequence[int], found: dict[Key, Measures]) -> list[Effect]:
    """Return every measure of a mechanism over the seeds of which both runs are known."""
    pairs = [(found[on], found[off]) for on, off in (keys(mechanism, s) for s in seeds) if on in found and off in found]
    return [effect(name, np.array([(on[name], off[name]) for on, off in pairs])) for name in mechanism.measures]


def effect(measure: str, values: np.ndarray) -> Effect:
    """Return the effect from values (pairs, 2), with and without; pairs with a NaN do not count."""
    values = values.reshape(-1, 2)
    values = values[np.isfinite(values).all(axis=1)]
    n = len(values)
    if n == 0:
        return Effect(measure, 0, *(math.nan,) * 7)
    difference = values[:, 1] - values[:, 0]
    error = float(difference.std(ddof=1) / math.sqrt(n)) if n > 1 else math.inf
    with_it, without = values.mean(axis=0).tolist()
    return Effect(
        measure=measure,
        pairs=n,
        with_it=with_it,
        without=without,
        worst_with=float(values[:, 0].max()),
        worst_without=float(values[:, 1].max()),
        difference=float(difference.mean()),
        half_width=float(student.ppf(0.975, n - 1)) * error if n > 1 else math.inf,
        detectable=DETECTABLE * error,
    )
