"""Tasks and workers: nothing lost, nothing doubled, whoever dies on the way."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from concurrent.futures import BrokenExecutor, Executor, ThreadPoolExecutor

import pytest

from services.campaign.engine import MOST_LOSSES, Local, batches, done
from services.campaign.trial import Row, Trial

TRIALS = [Trial(place, place, 0, {}, {}, {}) for place in range(40)]


class Fragile:
    """Threads in place of processes. A task with a deadly trial takes the whole pool with it, as a process's death."""

    workers = 2

    def __init__(self, deadly: dict[int, int]) -> None:
        self.deadly = deadly  # place: how often
        self.ran: list[int] = []
        self.renewed = 0
        self._broken = False
        self.executor: Executor = ThreadPoolExecutor(2)

    def work(self, trials: tuple[Trial, ...]) -> list[Row]:
        for trial in trials:
            if self._broken:
                raise BrokenExecutor
            if self.deadly.get(trial.place, 0) > 0:
                self.deadly[trial.place] -= 1
                self._broken = True
                raise BrokenExecutor
        self.ran += [trial.place for trial in trials]
        return [{"place": trial.place, "failed": None} for trial in trials]

    def lost(self, error: BaseException) -> bool:
        return isinstance(error, BrokenExecutor)

    def renew(self) -> None:
        self._broken = False
        self.renewed += 1

    def close(self) -> None:
        self.executor.shutdown()


@pytest.fixture
def fragile(request: pytest.FixtureRequest) -> Iterator[Fragile]:
    made = Fragile(request.param)
    yield made
    made.close()


def rows_of(engine: Fragile) -> list[Row]:
    tasks = batches(TRIALS, 1)
    return [row for rows in done(engine, engine.work, tasks, "v", stop=lambda: False) for row in rows]


@pytest.mark.parametrize("fragile", [{}, {7: 1}, {0: 1, 13: 2, 39: 1}], indirect=True)
def test_each_trial_has_one_row_however_often_workers_die(fragile: Fragile) -> None:
    rows = rows_of(fragile)
    assert sorted(row["place"] for row in rows) == list(range(40))
    assert all(row["failed"] is None for row in rows)


@pytest.mark.parametrize("fragile", [{13: 99}], indirect=True)
def test_a_run_that_ends_its_worker_each_time_is_given_up_and_no_other(fragile: Fragile) -> None:
    rows = rows_of(fragile)
    assert sorted(row["place"] for row in rows) == list(range(40))
    assert [row["place"] for row in rows if row["failed"]] == [13]
    assert fragile.deadly[13] == 99 - 1 - MOST_LOSSES  # once with others, then alone


def test_another_error_than_a_lost_worker_ends_the_campaign() -> None:
    engine = Fragile({})

    def wrong(trials: tuple[Trial, ...]) -> list[Row]:
        raise RuntimeError(f"another version, {len(trials)}")

    with pytest.raises(RuntimeError, match="another version"):
        list(done(engine, wrong, batches(TRIALS, 2), "v", stop=lambda: False))
    engine.close()


def test_told_to_stop_it_begins_nothing_more() -> None:
    engine = Fragile({})
    assert list(done(engine, engine.work, batches(TRIALS, 2), "v", stop=lambda: True)) == []
    assert engine.ran == []
    engine.close()


def killed_once(trials: tuple[Trial, ...]) -> list[Row]:
    """In a worker's process: the trial of place 1 kills it the first time that it is done anywhere."""
    for trial in trials:
        path = str(trial.settings["mark"])
        if trial.place == 1 and not os.path.exists(path):
            open(path, "w").close()
            os.kill(os.getpid(), signal.SIGKILL)
    return [{"place": trial.place, "failed": None} for trial in trials]


def test_a_process_that_is_killed_costs_no_row(tmp_path) -> None:
    trials = [Trial(place, place, 0, {"mark": str(tmp_path / "mark")}, {}, {}) for place in range(6)]
    engine = Local(2)
    try:
        rows = [row for some in done(engine, killed_once, batches(trials, 2), "v", stop=lambda: False) for row in some]
    finally:
        engine.close()
    assert (tmp_path / "mark").exists()
    assert sorted(row["place"] for row in rows) == list(range(6))
    assert all(row["failed"] is None for row in rows)
