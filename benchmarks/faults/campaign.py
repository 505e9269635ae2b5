"""Fault-injection campaign: runs in lock step on all cores and in processes side by side, each fault judged.

Outcomes are appended to a results store as runs end; a campaign that is continued makes the missing runs.

DIR/
    results.jsonl     a line a run: outcomes of its faults, or errors of a baseline run without faults (without-*)
    bus-*, node-*     runs of processes, removed after the verdict unless a requirement was violated
    faults.json       the whole, at the end
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from benchmarks.batch import as_plain, decode
from benchmarks.faults import datagrams, draw, lockstep, process_runs, recorded
from benchmarks.faults.draw import Pace, Run
from benchmarks.faults.judge import Errors, FaultOutcome, errors, judge
from benchmarks.faults.kinds import ATTACKS, DATAGRAMS, KINDS, NAMES, FaultClass, Place
from ltv_mpc.errors import ConfigError
from services.run.provenance import provenance_table
from services.tools.batch.executor import run_each
from services.tools.batch.results_store import ResultsStore
from services.tools.campaign.trial import version_of

SEVERAL, SEVERAL_QUICK = 8, 10
SEVERAL_IN_PROCESSES = 6
"""Number of faults in each run."""

A_SEED = 100
"""Number of faults for each seed of the scenario; every seed also needs a run without faults."""

SEEDS_IN_PROCESSES = 2
SHARE_IN_PROCESSES = 0.2

PACE = Pace(afloat_s=30.0, first_s=50.0, after_s=61.0)
PACE_IN_PROCESSES = Pace(afloat_s=10.0, first_s=20.0, after_s=61.0)
QUICK = Pace(afloat_s=3.0, first_s=5.0, after_s=2.5, longest_s=2.0, pause_s=0.3)
QUICK_IN_PROCESSES = Pace(afloat_s=4.0, first_s=5.0, after_s=2.5, longest_s=1.5, pause_s=0.3)
"""Quick runs do not judge the error a minute later. Attacks on processes are left out unless requested: a run in which
processes restart takes a minute.
"""

LAST_S = 10.0
"""Extra duration of a run of processes (s), so that it lasts 70 s after the end of its last fault."""

CORES_A_RUN, LOAD = 0.5, 0.7
"""Processor use of a run of processes (cores), and the share of all cores that they may use: limits in wall time can
only be met on a machine that is not overloaded.
"""

WITHOUT = "without-"

Tell = Callable[[int], None]


class Unmeasured(RuntimeError):
    """The run without faults, which is the baseline of the verdicts, could not be measured."""


class Task(NamedTuple):
    """Run of the campaign; ``way``: "lockstep", "flight" (datagrams of strangers), "bus" (messages are harmed) or
    "node" (processes are attacked).
    """

    name: str
    way: str
    run: Run

    @property
    def baseline(self) -> str:
        """Name of the run without faults with which it is compared."""
        return f"{WITHOUT}{self.way}-{self.run.seed}"


class Campaign(NamedTuple):
    """Number of faults and their classes, in lock step and in processes."""

    inside: tuple[FaultClass, ...]
    outside: tuple[FaultClass, ...]
    n_inside: int
    n_outside: int
    seed: int
    quick: bool

    @property
    def total(self) -> int:
        """Number of faults in all."""
        return self.n_inside + self.n_outside

    @property
    def settings(self) -> dict[str, Any]:
        """Settings that determine the faults, and the version of the software under test."""
        return {
            "classes": [f"{kind.name} in {kind.place}" for kind in (*self.inside, *self.outside)],
            "in_lockstep": self.n_inside,
            "in_processes": self.n_outside,
            "seed": self.seed,
            "quick": self.quick,
            "version": version_of(provenance_table()),
        }

    @property
    def tasks(self) -> list[Task]:
        """All runs with faults."""
        pace, several = (QUICK, SEVERAL_QUICK) if self.quick else (PACE, SEVERAL)
        seeds = max(1, self.n_inside // A_SEED)
        tasks = self._of_ways(("lockstep", "flight"), self.inside, self.n_inside, several, seeds, pace, 0.0)
        pace, longer_s = (QUICK_IN_PROCESSES, 0.0) if self.quick else (PACE_IN_PROCESSES, LAST_S)
        several, seeds = SEVERAL_IN_PROCESSES, SEEDS_IN_PROCESSES
        tasks += self._of_ways(("bus", "node"), self.outside, self.n_outside, several, seeds, pace, longer_s)
        return tasks

    def _of_ways(self, ways: tuple[str, str], kinds: Sequence[FaultClass], n: int, *others: Any) -> list[Task]:
        """Return the runs of both ways; the second way has its share of the faults."""
        second = [kind for kind in kinds if way_of(kind) == ways[1]]
        of_second = len(second) * n // max(1, len(kinds))
        first = [kind for kind in kinds if kind not in second]
        return [*self._tasks(ways[0], first, n - of_second, *others), *self._tasks(ways[1], second, of_second, *others)]

    def _tasks(
        self, way: str, kinds: Sequence[FaultClass], n: int, several: int, seeds: int, pace: Pace, longer_s: float
    ) -> list[Task]:
        if not (kinds and n):
            return []
        runs = draw.runs(kinds, n, seed=self.seed, several=several, seeds=seeds, pace=pace)
        longer = [msgspec.structs.replace(run, duration_s=run.duration_s + longer_s) for run in runs]
        return [Task(f"{way}-{i:03d}", way, run) for i, run in enumerate(longer)]


def way_of(kind: FaultClass) -> str:
    """Return the kind of run in which faults of a class are injected."""
    if kind.place is Place.LOCKSTEP:
        return "flight" if kind.name == DATAGRAMS else "lockstep"
    return "node" if kind.name in ATTACKS else "bus"


def plan(classes: str, where: str, n: int, *, seed: int = 0, quick: bool = False) -> Campaign:
    """Parse the command's options; ``classes`` are names joined by commas, all if empty. Raises ``ConfigError``."""
    wanted = [name.strip() for name in classes.split(",") if name.strip()]
    for name in wanted:
        if name not in NAMES:
            raise ConfigError("option --classes", "", f"must be one of {', '.join(NAMES)}", value=name)
    wanted = wanted or [name for name in NAMES if not (quick and name in ATTACKS)]
    kinds = [kind for kind in KINDS if kind.name in wanted and where in ("both", kind.place)]
    if not kinds:
        raise ConfigError("option --where", "", f"no fault class of {', '.join(wanted)} exists there", value=where)
    here = tuple(kind for kind in kinds if kind.place is Place.LOCKSTEP)
    there = tuple(kind for kind in kinds if kind.place is Place.PROCESSES)
    in_processes = 0 if not there else n if not here else min(n, max(round(n * SHARE_IN_PROCESSES), len(there)))
    return Campaign(here, there, n - in_processes, in_processes, seed, quick)


class Job(NamedTuple):
    """Run to make, its folder if it is one of processes, and its baseline. None: errors are not judged."""

    task: Task
    folder: Path
    baseline: Errors | None = None


def make(job: Job) -> list[FaultOutcome] | Errors:
    """Make a run and judge its faults; return the errors of a run without faults."""
    run, folder = job.task.run, job.folder
    if job.task.way == "flight":
        return datagrams.observe(run)
    if job.task.way != "lockstep":
        remove(folder)  # what an interrupted run has left
        ways = {"node": process_runs.attacked, "bus": process_runs.behind_injector}
        return verdict(job, ways[job.task.way](run, folder))
    of, cases = lockstep.observe(run)
    return judge(run.seed, Place.LOCKSTEP, of.log, cases, job.baseline) if run.faults else errors(of.log)


def verdict(job: Job, ended: recorded.Ended) -> list[FaultOutcome] | Errors:
    """Judge the faults of a run of processes that has ended; return the errors of a run without faults.

    Raises ``Unmeasured`` if a run without faults has no recording; faults without one are not observed.
    """
    run, place = job.task.run, Place.PROCESSES
    if not (job.folder / "run.mcap").exists():
        why = ended.uncontrolled or "there is no recording"
        if not run.faults:
            raise Unmeasured(f"{job.task.name}: the run without faults has no recording ({why})")
        found = [FaultOutcome(fault=one.fault, place=place, run_seed=run.seed) for one in ended.injected]
        return [*found[:-1], *(msgspec.structs.replace(one, uncontrolled=why) for one in found[-1:])]
    of, cases = recorded.observe(job.folder, lockstep.run_config(run).vehicle, ended)
    return judge(run.seed, place, of.log, cases, job.baseline) if run.faults else errors(of.log)


def run(
    of: Campaign,
    store: ResultsStore,
    *,
    progress: Tell = lambda _: None,
    make: Callable[[Job], list[FaultOutcome] | Errors] = make,
) -> list[FaultOutcome]:
    """Make all runs that ``store`` lacks and return the verdict on every fault. ``progress`` receives counts of faults
    done.
    """
    tasks, folder = of.tasks, store.path.parent
    progress(sum(len(task.run.faults) for task in tasks if task.name in store.keys))
    at_once = max(1, int(LOAD * (os.cpu_count() or 1) / CORES_A_RUN))
    # A few quick faults run in this process, because starting other processes takes longer.
    for ways, workers in ((("lockstep", "flight"), 1 if of.quick else None), (("bus", "node"), at_once)):
        here = [task for task in tasks if task.way in ways]
        missing = [task for task in here if task.name not in store.keys]
        alone = [] if of.quick or not missing else [Job(task, folder / task.name) for task in _alone(here)]
        alone = [job for job in alone if job.task.name not in store.keys]
        for place, result in run_each(make, alone, workers=workers):
            store.append(alone[place].task.name, as_plain(result))
            remove(alone[place].folder)
        baselines = {} if of.quick else without_faults(store)
        jobs = [Job(task, folder / task.name, baselines.get(task.baseline)) for task in missing]
        for place, seen in run_each(make, jobs, workers=workers):
            store.append(jobs[place].task.name, as_plain(seen))
            progress(len(jobs[place].task.run.faults))
            if not any(one.problems for one in seen):
                remove(jobs[place].folder)
    found = dict(store.results())
    return [one for task in tasks for one in decode(found[task.name], list[FaultOutcome])]


def without_faults(store: ResultsStore) -> dict[str, Errors]:
    """Return the errors of all baseline runs (without faults), by name."""
    found = {key: decode(result, Errors) for key, result in store.results() if key.startswith(WITHOUT)}
    return {key: found[key]._replace(true_m=found[key].true_m.reshape(-1, 2)) for key in sorted(found)}


def _alone(tasks: Sequence[Task]) -> list[Task]:
    """Return one baseline run for each way and seed, as long as the longest run with faults of that seed."""
    tasks = [task for task in tasks if task.way != "flight"]  # which has its own
    longest = {task.baseline: task for task in sorted(tasks, key=lambda task: task.run.duration_s)}
    return [
        Task(name, task.way, msgspec.structs.replace(task.run, faults=())) for name, task in sorted(longest.items())
    ]


def remove(folder: Path) -> None:
    """Remove the folder and the log of a run of processes."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.with_suffix(".log").unlink(missing_ok=True)
