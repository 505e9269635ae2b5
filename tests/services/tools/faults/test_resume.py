"""An interrupted campaign continues with the missing runs, and with nothing else."""

from __future__ import annotations

import math
import threading

import numpy as np
import pytest

from services.tools.batch.results_store import NAME, open_store
from services.tools.faults import campaign
from services.tools.faults.fault import Fault, FaultOutcome, Place
from services.tools.faults.judge import Errors
from services.tools.faults.parallel_runs import CORES_A_RUN, Machine, run_in_parallel
from services.tools.faults.process_verdict import OfProcesses

NOTHING = Errors(np.arange(3.0), np.ones(3), np.zeros((3, 2)), np.zeros(3, dtype=bool))


def seen(fault: Fault, **changes) -> FaultOutcome:
    values = {"harmed": 0, "reaction_s": None, "late": "", "worst_error_m": 0.1, "grown_m": 0.1, "bound_m": None}
    values |= {"ratio": 1.0, "window_ratio": 1.0, "outside_s": 0.0, "uncounted": 0, "bad_thrusts": 0}
    return FaultOutcome(fault=fault, place=Place.LOCKSTEP, run_seed=1, **(values | changes))


class Interrupted(campaign.RunMaker):
    """Runs that take no time, listed in ``made`` by their seeds (negative without faults); the third is interrupted."""

    workers = 1

    def __init__(self) -> None:
        self.made: list[int] = []

    def judged(self, job):
        if len(self.made) == 2 and job.run.faults[0].seed not in self.made:
            raise KeyboardInterrupt
        self.made.append(job.run.faults[0].seed)
        return [seen(fault) for fault in job.run.faults]

    def undisturbed(self, run):
        self.made.append(-run.seed)
        return NOTHING


def go(folder, maker) -> list[FaultOutcome]:
    return results(campaign.plan("external_force", "lockstep", 40), folder, maker)


def results(plan, folder, maker, *, force=False) -> list[FaultOutcome]:
    with open_store(folder, plan.settings(seed=3, quick=False), force=force) as store:
        return campaign.run(plan, store, seed=3, quick=False, maker=maker)


def test_a_continued_campaign_repeats_no_run_that_has_a_result(tmp_path):
    maker = Interrupted()
    made = maker.made
    with pytest.raises(KeyboardInterrupt):
        go(tmp_path, maker)
    assert made[0] == -3000
    first = made[1]
    with (tmp_path / NAME).open("a") as file:
        file.write('{"key":"lockstep-001","re')  # cut off as it was written
    made.clear()
    with pytest.raises(KeyboardInterrupt):
        go(tmp_path, maker)
    assert len(made) == 2
    assert -3000 not in made
    assert first not in made


class Instant(campaign.RunMaker):
    """Runs of processes that take no time; the verdict on "node-001" is a violation."""

    def __init__(self) -> None:
        self.made: list[str] = []
        self.records = True

    def processes(self, _way, run, folder):
        folder.mkdir()
        self.made.append(folder.name)
        if self.records and not run.faults:
            (folder / "run.mcap").touch()
        return OfProcesses(run, folder, (), (), "")

    def judged_processes(self, ended, _vehicle, _baseline):
        late = "did not recover" if ended.folder.name == "node-001" else ""
        return [seen(fault, late=late) for fault in ended.run.faults]

    def undisturbed_processes(self, _recording, _vehicle):
        return NOTHING


def test_runs_of_processes_are_made_once_and_kept_only_after_a_violation(tmp_path):
    maker = Instant()
    made = maker.made
    plan = campaign.plan("process_crash,message_loss", "processes", 14)
    found = results(plan, tmp_path, maker)
    assert sorted(made) == [
        *("bus-000", "bus-001", "node-000", "node-001"),
        *(f"without-{way}-{seed}" for way in ("bus", "node") for seed in (3000, 3001)),
    ]
    assert [path.name for path in tmp_path.iterdir() if path.is_dir()] == ["node-001"]
    made.clear()
    (tmp_path / "node-001" / "run.mcap").write_text("of the first time")
    lines = (tmp_path / NAME).read_text().splitlines()
    (tmp_path / NAME).write_text("".join(f"{line}\n" for line in lines if "node-001" not in line))
    again = results(plan, tmp_path, maker)
    assert made == ["node-001"]
    assert not (tmp_path / "node-001" / "run.mcap").exists()
    assert again == found
    assert len(found) == 14
    maker.records = False
    with pytest.raises(campaign.Unmeasured, match=r"without-\w+-300\d: the run"):
        results(plan, tmp_path, maker, force=True)


class FourCores(Machine):
    """Machine of four cores; the first run takes ten seconds and ``processor_s`` of processor time."""

    cores = 4

    def __init__(self, processor_s: float) -> None:
        self._processor_s, self._wall_s = iter([0.0, processor_s]), iter([0.0, 10.0])

    def processor_s(self):
        return next(self._processor_s)

    def wall_s(self):
        return next(self._wall_s)


@pytest.mark.parametrize(("processor_s", "at_once"), [(30.0, 1), (7.0, 4)])
def test_the_first_run_of_processes_measures_how_many_run_in_parallel(processor_s, at_once):
    """On four cores of which 2.8 may be used: one at a time where a run takes three, four of 0.7 each."""
    lock, running, together = threading.Lock(), [], []
    meet = threading.Barrier(at_once)

    def make(task):
        with lock:
            running.append(task)
            together.append(len(running))
        if len(together) > 1:
            meet.wait(20)
        with lock:
            running.remove(task)
        return task

    tasks = list(range(1 + 2 * at_once))
    machine = FourCores(processor_s)
    ended: list[int] = []
    run_in_parallel(make, tasks, lambda task, _: ended.append(task), None, machine)
    assert sorted(ended) == tasks
    assert together[0] == 1
    assert max(together) == at_once
    assert machine.at_a_time(CORES_A_RUN) == 7


def test_errors_without_faults_are_restored_from_the_store(tmp_path):
    """Errors of a run without any estimate too."""
    empty = Errors(np.empty(0), np.empty(0), np.empty((0, 2)), np.empty(0, dtype=bool))
    fault = Fault(kind="external_force", target="vehicle", start_s=1.0, end_s=2.0, size=3.0, seed=4)
    with open_store(tmp_path, {}) as store:
        store.append("without-lockstep-3001", empty)
        store.append("lockstep-000", [seen(fault, ratio=math.inf)])
        store.append("without-lockstep-3000", NOTHING)
        found = campaign.without_faults(store)
    assert list(found) == ["without-lockstep-3000", "without-lockstep-3001"]
    for here, there in zip(found.values(), (NOTHING, empty), strict=True):
        for a, b in zip(here, there, strict=True):
            np.testing.assert_array_equal(a, b)
            assert (a.shape, a.dtype) == (b.shape, b.dtype)
