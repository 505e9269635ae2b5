"""Fault-injection campaign: runs in lock step on all cores and in processes side by side, each fault judged.

Outcomes are appended to a results store as runs end; a campaign that is continued makes the missing runs.

DIR/
    results.jsonl     a line a run: outcomes of its faults, or errors of a baseline run without faults (without-*)
    bus-*, node-*     runs of processes, removed after the verdict unless a requirement was violated
    faults.json       the whole, at the end
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from ltv_mpc.errors import ConfigError
from ltv_mpc.vehicle.parameters import Vehicle
from services.run.provenance import provenance_table
from services.tools.batch.executor import run_each
from services.tools.batch.results_store import ResultsStore, decode
from services.tools.campaign.trial import version_of
from services.tools.faults import bench, draw, lockstep_runs, process_runs, recorded
from services.tools.faults.attacks import ATTACKS
from services.tools.faults.draw import Pace, Run
from services.tools.faults.fault import FaultOutcome, Place
from services.tools.faults.judge import Errors, errors, judge
from services.tools.faults.kinds import KINDS, NAMES, FaultClass
from services.tools.faults.parallel_runs import CORES_A_RUN, run_in_parallel
from services.tools.faults.process_verdict import OfProcesses
from services.tools.faults.process_verdict import judge as judge_processes
from services.tools.faults.result import problems

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

Tell = Callable[[int], None]


class Unmeasured(RuntimeError):
    """The run without faults, which is the baseline of the verdicts, could not be measured."""


class FaultCounts(NamedTuple):
    """Number of faults and their classes, in lock step and in processes."""

    inside: tuple[FaultClass, ...]
    outside: tuple[FaultClass, ...]
    n_inside: int
    n_outside: int

    @property
    def total(self) -> int:
        """Number of faults in all."""
        return self.n_inside + self.n_outside

    def settings(self, *, seed: int, quick: bool) -> dict[str, Any]:
        """Return the settings that determine the faults, and the version of the software under test."""
        return {
            "classes": [f"{kind.name} in {kind.place}" for kind in (*self.inside, *self.outside)],
            "in_lockstep": self.n_inside,
            "in_processes": self.n_outside,
            "seed": seed,
            "quick": quick,
            "version": version_of(provenance_table()),
        }


def plan(classes: str, where: str, n: int, *, quick: bool = False) -> FaultCounts:
    """Parse the command's options; ``classes`` are names joined by commas, all if empty. Raises ``ConfigError``."""
    wanted = [name.strip() for name in classes.split(",") if name.strip()]
    for name in wanted:
        if name not in NAMES:
            raise ConfigError("option --classes", "", f"must be one of {', '.join(NAMES)}", value=name)
    wanted = wanted or [name for name in NAMES if not (quick and name in ATTACKS)]
    places = {"both": set(Place), **{place.value: {place} for place in Place}}
    if where not in places:
        raise ConfigError("option --where", "", "must be lockstep, processes or both", value=where)
    kinds = [kind for kind in KINDS if kind.name in wanted and kind.place in places[where]]
    if not kinds:
        raise ConfigError("option --where", "", f"no fault class of {', '.join(wanted)} exists there", value=where)
    here = tuple(kind for kind in kinds if kind.place is Place.LOCKSTEP)
    there = tuple(kind for kind in kinds if kind.place is Place.PROCESSES)
    in_processes = 0 if not there else n if not here else min(n, max(round(n * SHARE_IN_PROCESSES), len(there)))
    return FaultCounts(here, there, n - in_processes, in_processes)


def run(
    counts: FaultCounts,
    store: ResultsStore,
    *,
    seed: int,
    quick: bool,
    progress: Tell = lambda _: None,
    maker: RunMaker | None = None,
) -> list[FaultOutcome]:
    """Make all runs that ``store`` lacks and return the verdict on every fault. ``progress`` receives counts of faults
    done.
    """
    names: list[str] = []
    maker = maker or RunMaker()
    if counts.n_inside:
        names += in_lockstep(
            counts.inside, counts.n_inside, store, seed=seed, quick=quick, maker=maker, progress=progress
        )
    if counts.n_outside:
        names += in_processes(
            counts.outside, counts.n_outside, store, seed=seed, quick=quick, maker=maker, progress=progress
        )
    found = dict(store.results())
    return [one for name in names for one in decode(found[name], list[FaultOutcome])]


def without_faults(store: ResultsStore) -> dict[str, Errors]:
    """Return the errors of all baseline runs (without faults), by name."""
    found = {key: decode(result, Errors) for key, result in store.results() if key.startswith(WITHOUT)}
    return {key: found[key]._replace(true_m=found[key].true_m.reshape(-1, 2)) for key in sorted(found)}


# --- in lock step ----------------------------------------------------------------------------------------------------


class Job(NamedTuple):
    """Run in lock step and the errors of its seed without faults. None: errors are not judged."""

    run: Run
    baseline: Errors | None


class RunMaker:
    """The runs of a campaign as they are really made; a test replaces some of its methods."""

    workers: int | None = None
    """Number of simultaneous runs in lock step; None: one for each core."""

    ways: tuple[str, ...] = ("bus", "node")
    """Ways to run processes: those whose messages are harmed, and those that are attacked themselves."""

    def judged(self, job: Job) -> list[FaultOutcome]:
        """Make a run in lock step in this process and judge its faults."""
        return judge(job.run, lockstep_runs.observe(job.run), job.baseline)

    def undisturbed(self, run: Run) -> Errors:
        """Return the errors of a run in lock step without faults."""
        return errors(lockstep_runs.observe(run).log)

    def processes(self, way: str, run: Run, folder: Path) -> OfProcesses:
        """Run processes in one of the ``ways``."""
        return under_supervisor(run, folder) if way == "node" else behind_injector(run, folder)

    def judged_processes(self, ended: OfProcesses, vehicle: Vehicle, baseline: Errors | None) -> list[FaultOutcome]:
        """Judge the faults of a run of processes by its recording."""
        return judge_processes(ended, vehicle, baseline)

    def undisturbed_processes(self, recording: Path, vehicle: Vehicle) -> Errors:
        """Return the errors of a recorded run of processes without faults."""
        return errors(recorded.read(recording, vehicle).log)

    def clear(self, folder: Path) -> None:
        """Remove the folder of a run of processes in which all was well."""
        remove(folder)


def in_lockstep(
    kinds: Sequence[FaultClass], n: int, store: ResultsStore, *, seed: int, quick: bool, maker: RunMaker, progress: Tell
) -> list[str]:
    """Inject ``n`` faults of these classes in lock step and return the names of the runs. All available cores are used;
    a few quick faults run in this process, because starting other processes takes longer.
    """
    pace, workers = (QUICK, 1) if quick else (PACE, maker.workers)
    several = SEVERAL_QUICK if quick else SEVERAL
    runs = draw.runs(kinds, n, seed=seed, several=several, seeds=max(1, n // A_SEED), pace=pace)
    names = [f"lockstep-{i:03d}" for i in range(len(runs))]
    missing = [i for i, name in enumerate(names) if name not in store.keys]
    progress(sum(len(run.faults) for i, run in enumerate(runs) if i not in missing))
    if missing and not quick:
        alone = [run for run in _alone(runs) if _without("lockstep", run.seed) not in store.keys]
        for place, result in run_each(maker.undisturbed, alone, workers=workers):
            store.append(_without("lockstep", alone[place].seed), result)
    baselines = {} if quick else without_faults(store)
    jobs = [Job(runs[i], baselines.get(_without("lockstep", runs[i].seed))) for i in missing]
    for place, seen in run_each(maker.judged, jobs, workers=workers):
        store.append(names[missing[place]], seen)
        progress(len(jobs[place].run.faults))
    return names


WITHOUT = "without-"


def _without(way: str, seed: int) -> str:
    """Return the name of a seed's baseline run."""
    return f"{WITHOUT}{way}-{seed}"


def _alone(runs: Sequence[Run]) -> list[Run]:
    """Return one baseline run for each seed, as long as the longest run with faults of that seed."""
    longest: dict[int, Run] = {}
    for run in sorted(runs, key=lambda run: run.duration_s):
        longest[run.seed] = run
    return [msgspec.structs.replace(longest[seed], faults=()) for seed in sorted(longest)]


# --- in processes ----------------------------------------------------------------------------------------------------


class Task(NamedTuple):
    """Run of processes that has not been made yet."""

    name: str
    way: str  # of ``RunMaker.ways``
    run: Run


def in_processes(
    kinds: Sequence[FaultClass], n: int, store: ResultsStore, *, seed: int, quick: bool, maker: RunMaker, progress: Tell
) -> list[str]:
    """Inject ``n`` faults of these classes in processes and return the names of the runs. Each run has its own folder
    beside the store.
    """
    folder = store.path.parent
    tasks = [task for way in maker.ways for task in _tasks(way, kinds, n, seed=seed, quick=quick)]
    missing = [task for task in tasks if task.name not in store.keys]
    progress(sum(len(task.run.faults) for task in tasks if task not in missing))
    vehicle = lockstep_runs.run_config(tasks[0].run).vehicle
    cores = CORES_A_RUN if quick else None

    def make(task: Task) -> OfProcesses:
        return maker.processes(task.way, task.run, _empty(folder / task.name))

    if missing and not quick:
        alone = [
            Task(name, way, run)
            for way in maker.ways
            for run in _alone([task.run for task in tasks if task.way == way])
            if (name := _without(way, run.seed)) not in store.keys
        ]

        def keep_errors(task: Task, ended: OfProcesses) -> None:
            if not (recording := ended.folder / "run.mcap").exists():
                raise Unmeasured(f"{ended.folder}: the run without faults has no recording ({ended.uncontrolled})")
            store.append(task.name, maker.undisturbed_processes(recording, vehicle))
            maker.clear(ended.folder)

        cores = run_in_parallel(make, alone, keep_errors, cores)
    baselines = {} if quick else without_faults(store)

    def keep(task: Task, ended: OfProcesses) -> None:
        seen = maker.judged_processes(ended, vehicle, baselines.get(_without(task.way, task.run.seed)))
        store.append(task.name, seen)
        progress(len(task.run.faults))
        if not any(map(problems, seen)):
            maker.clear(ended.folder)

    run_in_parallel(make, missing, keep, cores)
    return [task.name for task in tasks]


def _tasks(way: str, kinds: Sequence[FaultClass], n: int, *, seed: int, quick: bool) -> list[Task]:
    """Return the runs of a way, with its share of the ``n`` faults."""
    own = [kind for kind in kinds if (kind.name in ATTACKS) is (way == "node")]
    to_nodes = sum(kind.name in ATTACKS for kind in kinds) * n // len(kinds)
    count = to_nodes if way == "node" else n - to_nodes
    if not own or not count:
        return []
    pace = QUICK_IN_PROCESSES if quick else PACE_IN_PROCESSES
    runs = draw.runs(own, count, seed=seed, several=SEVERAL_IN_PROCESSES, seeds=SEEDS_IN_PROCESSES, pace=pace)
    longer_s = 0.0 if quick else LAST_S
    return [
        Task(f"{way}-{i:03d}", way, msgspec.structs.replace(run, duration_s=run.duration_s + longer_s))
        for i, run in enumerate(runs)
    ]


def _empty(folder: Path) -> Path:
    """Remove what an interrupted run has left in the folder; return the folder."""
    remove(folder)
    return folder


def remove(folder: Path) -> None:
    """Remove the folder and the log of a run of processes."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.with_suffix(".log").unlink(missing_ok=True)


def under_supervisor(run: Run, folder: Path) -> OfProcesses:
    """Run ``ltv-mpc sim`` and attack its processes."""
    ended = process_runs.supervised(run, folder)
    uncontrolled = "" if ended.code == 0 else f"exit code {ended.code}: {ended.output}"
    return OfProcesses(run, folder, ended.injected, (), uncontrolled)


def behind_injector(run: Run, folder: Path) -> OfProcesses:
    """Run processes with an injector between the controller and all others."""
    of = bench.run_config(run, speed=process_runs.SPEED)
    patience_s = process_runs.START_S + 2.0 * (run.duration_s + run.afloat_s) / process_runs.SPEED
    account = bench.run(of, run.faults, folder, patience_s=patience_s)
    injected = [process_runs.Injected(fault, 0, round(fault.start_s * 1e9)) for fault in run.faults]
    failed = {name: code for name, code in account.codes.items() if code != 0}
    uncontrolled = f"exit codes {failed}: {account.output}" if failed else ""
    return OfProcesses(run, folder, injected, account.harmed, uncontrolled)
