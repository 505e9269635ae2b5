"""A campaign that is interrupted goes on with what is missing, and with nothing else."""

from __future__ import annotations

import math
import threading
from types import SimpleNamespace

import numpy as np
import pytest

from services.tools.batch import executor
from services.tools.batch.results_store import NAME, open_store
from services.tools.faults import campaign
from services.tools.faults.fault import Fault, FaultOutcome, Place
from services.tools.faults.judge import Errors
from services.tools.faults.process_verdict import OfProcesses

NOTHING = Errors(np.arange(3.0), np.ones(3), np.zeros((3, 2)), np.zeros(3, dtype=bool))


def seen(fault: Fault, **changes) -> FaultOutcome:
    values = {"harmed": 0, "reaction_s": None, "late": "", "worst_error_m": 0.1, "grown_m": 0.1, "bound_m": None}
    values |= {"ratio": 1.0, "window_ratio": 1.0, "outside_s": 0.0, "uncounted": 0, "bad_thrusts": 0}
    return FaultOutcome(fault=fault, place=Place.LOCKSTEP, run_seed=1, **(values | changes))


@pytest.fixture
def made(monkeypatch):
    """Runs that take no time: which of them were made, with and without faults; it stops at the third."""
    made: list[int] = []

    def judged(job):
        if len(made) == 2 and job.run.faults[0].seed not in made:
            raise KeyboardInterrupt
        made.append(job.run.faults[0].seed)
        return [seen(fault) for fault in job.run.faults]

    def undisturbed(run):
        made.append(-run.seed)
        return NOTHING

    monkeypatch.setattr(executor, "core_count", lambda: 1)
    monkeypatch.setattr(campaign, "judged", judged)
    monkeypatch.setattr(campaign, "undisturbed", undisturbed)
    return made


def go(folder) -> list[FaultOutcome]:
    return made_of(campaign.plan("external_force", "lockstep", 40), folder)


def made_of(plan, folder, *, force=False) -> list[FaultOutcome]:
    with open_store(folder, plan.settings(seed=3, quick=False), force=force) as store:
        return campaign.run(plan, store, seed=3, quick=False)


def test_what_an_interrupted_campaign_has_found_is_not_made_again(made, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        go(tmp_path)
    assert made[0] == -3000
    first = made[1]
    with (tmp_path / NAME).open("a") as file:
        file.write('{"key":"lockstep-001","re')  # cut off as it was written
    made.clear()
    with pytest.raises(KeyboardInterrupt):
        go(tmp_path)
    assert len(made) == 2
    assert -3000 not in made
    assert first not in made


def test_runs_of_processes_are_made_once_and_stay_only_if_something_was_not_as_promised(monkeypatch, tmp_path):
    made: list[str] = []
    recorded = True

    def make(run, folder):
        folder.mkdir()
        made.append(folder.name)
        if recorded and not run.faults:
            (folder / "run.mcap").touch()
        return OfProcesses(run, folder, (), (), "")

    def judged(of, _vehicle, _baseline):
        late = "never back" if of.folder.name == "node-001" else ""
        return [seen(fault, late=late) for fault in of.run.faults]

    monkeypatch.setattr(campaign, "WAYS", {"bus": make, "node": make})
    monkeypatch.setattr(campaign, "judge_processes", judged)
    monkeypatch.setattr(campaign.recorded, "read", lambda *_: SimpleNamespace(log=None))
    monkeypatch.setattr(campaign, "errors", lambda _: NOTHING)
    plan = campaign.plan("process_crash,message_loss", "processes", 12)
    found = made_of(plan, tmp_path)
    assert sorted(made) == [
        *("bus-000", "bus-001", "node-000", "node-001"),
        *(f"without-{way}-{seed}" for way in ("bus", "node") for seed in (3000, 3001)),
    ]
    assert [path.name for path in tmp_path.iterdir() if path.is_dir()] == ["node-001"]
    made.clear()
    (tmp_path / "node-001" / "run.mcap").write_text("of the first time")
    lines = (tmp_path / NAME).read_text().splitlines()
    (tmp_path / NAME).write_text("".join(f"{line}\n" for line in lines if "node-001" not in line))
    again = made_of(plan, tmp_path)
    assert made == ["node-001"]
    assert not (tmp_path / "node-001" / "run.mcap").exists()
    assert again == found
    assert len(found) == 12
    recorded = False
    with pytest.raises(campaign.Unmeasured, match=r"without-\w+-300\d: the run"):
        made_of(plan, tmp_path, force=True)


@pytest.mark.parametrize(("busy", "most"), [(True, 1), (False, 4)])
def test_the_first_run_of_processes_is_alone_and_what_it_takes_says_how_many_go_side_by_side(
    monkeypatch, tmp_path, busy, most
):
    """On four cores of which 2.8 may be used: one at a time where a run takes three, four of 0.7 each."""
    lock, running, together = threading.Lock(), [], []
    meet = threading.Barrier(most)
    times = iter([0.0, 30.0 if busy else 7.0])

    def make(run, folder):
        with lock:
            running.append(folder.name)
            together.append(len(running))
        if len(together) > 1:
            meet.wait(20)
        with lock:
            running.remove(folder.name)
        return OfProcesses(run, folder, (), (), "")

    monkeypatch.setattr(campaign, "WAYS", {"bus": make})
    monkeypatch.setattr(campaign, "_work_s", lambda: next(times))
    monkeypatch.setattr(campaign.time, "monotonic", iter([0.0, 10.0]).__next__)
    monkeypatch.setattr(campaign.os, "cpu_count", lambda: 4)
    tasks = [campaign.Task(f"bus-{i:03d}", "bus", None) for i in range(1 + 2 * most)]
    ended: list[str] = []
    campaign._side_by_side(tasks, tmp_path, lambda task, _: ended.append(task.name), None)
    assert sorted(ended) == [task.name for task in tasks]
    assert together[0] == 1
    assert max(together) == most
    assert campaign.at_a_time(campaign.CORES_A_RUN) == 7


def test_errors_without_faults_come_back_as_they_were_and_alone(tmp_path):
    """Those of a run too, of which no estimate was left."""
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
