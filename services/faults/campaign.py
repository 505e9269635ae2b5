"""The whole campaign: faults drawn, runs made in lock step on all cores and in processes side by side, each judged."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import NamedTuple

import msgspec

from ltv_mpc.errors import ConfigError
from services.faults import bench, draw, inside, outside, recorded
from services.faults.attacks import ATTACKS
from services.faults.draw import Pace, Run
from services.faults.fault import Place, Seen
from services.faults.judge import Errors, errors, judge
from services.faults.judge_outside import OfProcesses
from services.faults.judge_outside import judge as judge_processes
from services.faults.kinds import KINDS, NAMES, Kind
from services.measure.batch import each

SEVERAL, SEVERAL_QUICK = 8, 10
SEVERAL_IN_PROCESSES = 5
"""Faults a run."""

A_SEED = 100
"""Faults for each seed of the scenario: every seed needs a run without faults."""

SEEDS_IN_PROCESSES = 2
SHARE_IN_PROCESSES = 0.22

PACE = Pace(afloat_s=30.0, first_s=50.0, after_s=61.0)
PACE_IN_PROCESSES = Pace(afloat_s=10.0, first_s=20.0, after_s=61.0)
QUICK = Pace(afloat_s=5.0, first_s=8.0, after_s=4.0, longest_s=4.0)
QUICK_IN_PROCESSES = Pace(afloat_s=5.0, first_s=8.0, after_s=10.0, longest_s=3.0)
"""Without a judgement of the error that is left a minute later."""

LAST_S = 10.0
"""In processes the run goes on so much longer after what is asked of the last fault: 70 s after its end."""

CORES_A_RUN = 0.4
LOAD = 0.7
"""What a run of processes at twice real time takes of a core, and how much of all of them runs may take."""

Tell = Callable[[int], None]


class Plan(NamedTuple):
    """How many faults of which classes, in lock step and in processes."""

    inside: tuple[Kind, ...]
    outside: tuple[Kind, ...]
    n_inside: int
    n_outside: int

    @property
    def total(self) -> int:
        """All of them."""
        return self.n_inside + self.n_outside


def plan(classes: str, where: str, n: int) -> Plan:
    """From the command's words: classes, names joined by commas, all if empty. Raises ``ConfigError``."""
    wanted = [name.strip() for name in classes.split(",") if name.strip()] or list(NAMES)
    for name in wanted:
        if name not in NAMES:
            raise ConfigError("option --classes", "", f"must be of {', '.join(NAMES)}", value=name)
    places = {"both": set(Place), **{place.value: {place} for place in Place}}
    if where not in places:
        raise ConfigError("option --where", "", "must be lockstep, processes or both", value=where)
    kinds = [kind for kind in KINDS if kind.name in wanted and kind.place in places[where]]
    if not kinds:
        raise ConfigError("option --where", "", f"no class of {', '.join(wanted)} is injected there", value=where)
    here = tuple(kind for kind in kinds if kind.place is Place.LOCKSTEP)
    there = tuple(kind for kind in kinds if kind.place is Place.PROCESSES)
    in_processes = 0 if not there else n if not here else min(n, max(round(n * SHARE_IN_PROCESSES), len(there)))
    return Plan(here, there, n - in_processes, in_processes)


def run(asked: Plan, *, seed: int, quick: bool, keep: Path | None, progress: Tell = lambda _: None) -> list[Seen]:
    """All of it. ``keep`` is the folder in which the runs of processes stay; None: they are removed."""
    seen: list[Seen] = []
    if asked.n_inside:
        seen += in_lockstep(asked.inside, asked.n_inside, seed=seed, quick=quick, progress=progress)
    if asked.n_outside:
        with tempfile.TemporaryDirectory(prefix="ltv-mpc-faults-") as temporary:
            folder = keep or Path(temporary)
            seen += in_processes(asked.outside, asked.n_outside, folder, seed=seed, quick=quick, progress=progress)
    return seen


# --- in lock step ----------------------------------------------------------------------------------------------------


class Job(NamedTuple):
    """A run, and the errors of its seed without faults; None: they are not judged."""

    run: Run
    baseline: Errors | None


def judged(job: Job) -> list[Seen]:
    """Run it here, in lock step."""
    return judge(job.run, inside.observe(job.run), job.baseline)


def undisturbed(run: Run) -> Errors:
    """The errors of a run without faults."""
    return errors(inside.observe(run).log)


def in_lockstep(
    kinds: Sequence[Kind],
    n: int,
    *,
    seed: int,
    quick: bool = False,
    workers: int | None = None,
    progress: Tell = lambda _: None,
) -> list[Seen]:
    """``n`` faults of these classes, in lock step; ``progress`` is told of faults that are done."""
    pace = QUICK if quick else PACE
    runs = draw.runs(
        kinds, n, seed=seed, several=SEVERAL_QUICK if quick else SEVERAL, seeds=max(1, n // A_SEED), pace=pace
    )
    baselines: dict[int, Errors] = {}
    if not quick:
        alone = _alone(runs)
        for place, result in each(undisturbed, alone, workers=workers):
            baselines[alone[place].seed] = result
    seen: dict[int, list[Seen]] = {}
    for place, of_run in each(judged, [Job(run, baselines.get(run.seed)) for run in runs], workers=workers):
        seen[place] = of_run
        progress(len(runs[place].faults))
    return [one for place in sorted(seen) for one in seen[place]]


def _alone(runs: Sequence[Run]) -> list[Run]:
    """For each seed a run without faults, as long as its longest one with."""
    longest: dict[int, float] = {}
    for run in runs:
        longest[run.seed] = max(run.duration_s, longest.get(run.seed, 0.0))
    afloat_s = runs[0].afloat_s
    return [Run(seed=seed, faults=(), duration_s=longest[seed], afloat_s=afloat_s) for seed in longest]


# --- in processes ----------------------------------------------------------------------------------------------------

Make = Callable[[Run, Path], OfProcesses]


def in_processes(
    kinds: Sequence[Kind],
    n: int,
    folder: Path,
    *,
    seed: int,
    quick: bool = False,
    side_by_side: int | None = None,
    progress: Tell = lambda _: None,
) -> list[Seen]:
    """``n`` faults of these classes in real processes, each run in a folder of its own below ``folder``."""
    pace = QUICK_IN_PROCESSES if quick else PACE_IN_PROCESSES
    of_processes = [kind for kind in kinds if kind.name in ATTACKS]
    of_messages = [kind for kind in kinds if kind not in of_processes]
    seen: list[Seen] = []
    for name, group, make in (("bus", of_messages, behind_injector), ("node", of_processes, under_supervisor)):
        if not group:
            continue
        count = n - len(of_processes) * n // len(kinds) if group is of_messages else len(of_processes) * n // len(kinds)
        runs = [
            run if quick else msgspec.structs.replace(run, duration_s=run.duration_s + LAST_S)
            for run in draw.runs(
                group, count, seed=seed, several=SEVERAL_IN_PROCESSES, seeds=SEEDS_IN_PROCESSES, pace=pace
            )
        ]
        seen += _side_by_side(name, runs, make, folder, quick=quick, most=side_by_side, progress=progress)
    return seen


def _side_by_side(
    name: str, runs: Sequence[Run], make: Make, folder: Path, *, quick: bool, most: int | None, progress: Tell
) -> list[Seen]:
    alone = [] if quick else _alone(runs)
    count = most or max(1, int(LOAD * (os.cpu_count() or 1) / CORES_A_RUN))
    with ThreadPoolExecutor(count) as pool:
        places = {
            pool.submit(make, run, folder / f"{name}-{i:03d}{'-without' if not run.faults else ''}"): i
            for i, run in enumerate([*alone, *runs])
        }
        ended: dict[int, OfProcesses] = {}
        for future in as_completed(places):
            ended[places[future]] = future.result()
            progress(len(ended[places[future]].run.faults))
    vehicle = inside.situation(runs[0]).vehicle
    baselines: dict[int, Errors] = {}
    for i, run in enumerate(alone):
        recording = ended[i].folder / "run.mcap"
        if recording.exists():
            baselines[run.seed] = errors(recorded.read(recording, vehicle).log)
    return [
        one
        for i, run in enumerate(runs, start=len(alone))
        for one in judge_processes(ended[i], vehicle, baselines.get(run.seed))
    ]


def under_supervisor(run: Run, folder: Path) -> OfProcesses:
    """``ltv-mpc sim``, its processes attacked."""
    ended = outside.supervised(run, folder)
    uncontrolled = "" if ended.code == 0 else f"exit code {ended.code}: {ended.words}"
    return OfProcesses(run, folder, ended.injected, (), uncontrolled)


def behind_injector(run: Run, folder: Path) -> OfProcesses:
    """Processes with an injector between."""
    of = bench.situation(run, speed=outside.SPEED)
    patience_s = outside.START_S + 2.0 * (run.duration_s + run.afloat_s) / outside.SPEED
    account = bench.run(of, run.faults, folder, patience_s=patience_s)
    injected = [outside.Injected(fault, 0, round(fault.start_s * 1e9)) for fault in run.faults]
    failed = {name: code for name, code in account.codes.items() if code != 0}
    uncontrolled = f"exit codes {failed}: {account.words}" if failed else ""
    return OfProcesses(run, folder, injected, account.harmed, uncontrolled)
