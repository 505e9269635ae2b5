"""An interrupted campaign continues with the missing runs, and with nothing else."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.faults import campaign
from benchmarks.faults.judge import Errors, FaultOutcome
from benchmarks.faults.kinds import Fault, Place
from services.tools.batch.results_store import NAME, open_store

NOTHING = Errors(np.arange(3.0), np.ones(3), np.zeros((3, 2)), np.zeros(3, dtype=bool))


def seen(fault: Fault, **changes) -> FaultOutcome:
    return FaultOutcome(**{"fault": fault, "place": Place.LOCKSTEP, "run_seed": 1, "ratio": 1.0} | changes)


class Maker:
    """Runs that take no time, listed in ``made``; the one named ``interrupted`` is, that named ``late`` violates."""

    def __init__(self, *, interrupted: str = "", late: str = "") -> None:
        self.made: list[str] = []
        self._interrupted, self._late = interrupted, late

    def __call__(self, job: campaign.Job) -> list[FaultOutcome] | Errors:
        if job.task.name == self._interrupted:
            raise KeyboardInterrupt
        self.made.append(job.task.name)
        if job.task.way != "lockstep":
            campaign.remove(job.folder)
            job.folder.mkdir()
        late = "did not recover" if job.task.name == self._late else ""
        faults = job.task.run.faults
        assert not faults or job.task.way == "lockstep" or job.baseline is not None
        return [seen(fault, late=late) for fault in faults] if faults else NOTHING


def results(plan: campaign.Campaign, folder: Path, make: Maker) -> list[FaultOutcome]:
    with open_store(folder, plan.settings) as store:
        return campaign.run(plan, store, make=make)


def test_a_continued_campaign_repeats_no_run_that_has_a_result(tmp_path):
    plan = campaign.plan("external_force", "lockstep", 40, seed=3, quick=True)  # in this process
    first = Maker(interrupted="lockstep-002")
    with pytest.raises(KeyboardInterrupt):
        results(plan, tmp_path, first)
    assert first.made == ["lockstep-000", "lockstep-001"]
    with (tmp_path / NAME).open("a") as file:
        file.write('{"key":"lockstep-002","re')  # cut off as it was written
    again = Maker()
    assert len(results(plan, tmp_path, again)) == 40
    assert again.made == ["lockstep-002", "lockstep-003"]


def test_runs_of_processes_are_made_once_and_kept_only_after_a_violation(tmp_path):
    plan = campaign.plan("process_crash,message_loss", "processes", 14, seed=3)
    first = Maker(late="node-001")
    found = results(plan, tmp_path, first)
    assert sorted(first.made) == [
        *("bus-000", "bus-001", "node-000", "node-001"),
        *(f"without-{way}-{seed}" for way in ("bus", "node") for seed in (3000, 3001)),
    ]
    assert [path.name for path in tmp_path.iterdir() if path.is_dir()] == ["node-001"]
    lines = (tmp_path / NAME).read_text().splitlines()
    (tmp_path / NAME).write_text("".join(f"{line}\n" for line in lines if "node-001" not in line))
    again = Maker(late="node-001")
    assert results(plan, tmp_path, again) == found
    assert again.made == ["node-001"]
    assert len(found) == 14
