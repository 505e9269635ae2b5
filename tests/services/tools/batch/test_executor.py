"""Jobs and workers: nothing lost, nothing doubled, whoever dies on the way."""

from __future__ import annotations

import math
import multiprocessing
import os
import signal
import time
from collections import Counter
from functools import partial
from pathlib import Path

import pytest

from ltv_mpc.errors import ConfigError
from services.tools.batch.executor import MAX_LOSSES, WorkerLost, in_order, run_each
from tests.waiting import until


def mortal(marks: Path, deadly: dict[int, int], job: int) -> int:
    """Interrupt this worker, and kill it as often as ``deadly`` says for the job. A file for each beginning."""
    began = len(list(marks.glob(f"{job}-*")))
    (marks / f"{job}-{began}").touch()
    os.kill(os.getpid(), signal.SIGINT)  # from the terminal: it is its parent's
    if began < deadly.get(job, 0):
        os.kill(os.getpid(), signal.SIGKILL)
    return -job


def slow(seconds: float) -> float:
    time.sleep(seconds)
    return seconds


def test_results_come_in_the_order_of_the_jobs() -> None:
    shares: list[float] = []
    assert in_order(slow, [1.0, 0.0], workers=2, progress=shares.append) == [1.0, 0.0]
    assert shares == [0.5, 1.0]


def refuse(job: int) -> None:
    raise ConfigError("scenario", "[water] sd_mps", "must be >= 0", value=job)


@pytest.mark.parametrize("workers", [1, 2])
def test_a_setting_that_a_worker_refuses_is_refused_here(workers: int) -> None:
    with pytest.raises(ConfigError, match=r"scenario: \[water\] sd_mps = -4: must be >= 0"):
        list(run_each(refuse, [-4, -4], workers=workers))


def test_each_job_has_one_result_and_only_one_that_ends_its_worker_each_time_is_given_up(tmp_path: Path) -> None:
    work = partial(mortal, tmp_path, {0: 1, 3: 99, 5: MAX_LOSSES - 1})
    done = list(run_each(work, range(8), workers=2, lost=lambda job: job + 1000))
    assert sorted(done) == sorted([*((job, -job) for job in range(8) if job != 3), (3, 1003)])
    began = Counter(path.name.partition("-")[0] for path in tmp_path.iterdir())
    assert began == Counter("01234567") + Counter("0335" + "5" * (MAX_LOSSES - 2))


def test_the_only_worker_is_another_process_where_its_loss_must_be_survived(tmp_path: Path) -> None:
    assert dict(run_each(partial(mortal, tmp_path, {0: 1}), [0, 1], workers=1, lost=lambda _: 7)) == {0: 0, 1: -1}
    with pytest.raises(WorkerLost, match="job 0 of 2"):
        list(run_each(partial(mortal, tmp_path, {9: 99}), [9, 10], workers=2))


def test_told_to_stop_it_begins_nothing_more(tmp_path: Path) -> None:
    for workers in (1, 2):
        assert list(run_each(partial(mortal, tmp_path, {}), range(9), workers=workers, stop=lambda: True)) == []
    assert not list(tmp_path.iterdir())


def write_pid_and_sleep(folder: Path, job: int) -> None:
    """Write the worker's pid, whole at once, and work for longer than the test. Job 1 ignores SIGTERM."""
    if job == 1:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
    (folder / f"{job}.part").write_text(str(os.getpid()))
    (folder / f"{job}.part").rename(folder / f"{job}.pid")
    time.sleep(3600.0)


def run_sleepers(folder: Path) -> None:
    list(run_each(partial(write_pid_and_sleep, folder), range(2), workers=2))


def is_alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_told_to_stop_it_ends_what_runs_and_kills_what_ignores_that(tmp_path: Path) -> None:
    before = set(multiprocessing.active_children())
    work = partial(write_pid_and_sleep, tmp_path)
    assert list(run_each(work, [0, 1, 2], workers=2, stop=lambda: len(list(tmp_path.glob("*.pid"))) == 2)) == []
    assert not set(multiprocessing.active_children()) - before
    assert not any(is_alive(int(path.read_text())) for path in tmp_path.glob("*.pid"))


def test_workers_end_with_a_parent_that_is_killed(tmp_path: Path) -> None:
    parent = multiprocessing.get_context("spawn").Process(target=run_sleepers, args=(tmp_path,))
    parent.start()
    try:
        until(lambda: len(list(tmp_path.glob("*.pid"))) == 2)
    finally:
        parent.kill()
        parent.join()
    until(lambda: not any(is_alive(int(path.read_text())) for path in tmp_path.glob("*.pid")))


@pytest.mark.timeout(700)
def test_a_cluster_that_loses_its_worker_on_the_way_does_each_job(tmp_path, monkeypatch) -> None:
    distributed = pytest.importorskip("distributed")
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        monkeypatch.setenv(name, "1")
    options = {
        "n_workers": 1,
        "threads_per_worker": 1,
        "dashboard_address": "127.0.0.1:0",
        "local_directory": str(tmp_path),
    }
    done: list[tuple[int, float]] = []
    with distributed.LocalCluster(**options) as cluster:
        for one in run_each(math.exp, [float(job) for job in range(12)], cluster=cluster.scheduler_address):
            done.append(one)
            if len(done) == 1:
                os.kill(cluster.workers[0].pid, signal.SIGKILL)
    assert sorted(done) == [(job, math.exp(job)) for job in range(12)]
