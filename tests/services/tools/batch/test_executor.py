"""Jobs and workers: nothing lost, nothing doubled, whoever dies on the way."""

from __future__ import annotations

import math
import multiprocessing
import os
import signal
import threading
import time
from collections import Counter
from functools import partial
from pathlib import Path

import pytest

from ltv_mpc.errors import ConfigError
from services.tools.batch.executor import MAX_LOSSES, WorkerLost, run_each
from tests.waiting import until


def mortal(marks: Path, deadly: dict[int, int], job: int) -> int:
    """Kill this worker as often as ``deadly`` says for the job, then do it. A file for each beginning."""
    began = len(list(marks.glob(f"{job}-*")))
    (marks / f"{job}-{began}").touch()
    if began < deadly.get(job, 0):
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(0.1)  # so long that it is lost with a deadly job beside it
    return -job


@pytest.mark.parametrize("how", [{"workers": 1}, {"workers": 2}, {"workers": 2, "threads": True}])
def test_what_a_job_raises_reaches_the_reader(how: dict) -> None:
    with pytest.raises(ValueError, match=r"math domain error|nonnegative"):
        list(run_each(math.sqrt, [4.0, -1.0, 9.0], **how))


@pytest.mark.parametrize("deadly", [{1: 1}, {0: 1, 5: 2, 11: 1}])
def test_each_job_has_one_result_however_often_workers_die(tmp_path: Path, deadly: dict[int, int]) -> None:
    done = list(run_each(partial(mortal, tmp_path, deadly), range(12), workers=2))
    assert sorted(done) == [(job, -job) for job in range(12)]


def test_a_job_that_ends_its_worker_each_time_is_given_up_and_no_other(tmp_path: Path) -> None:
    work = partial(mortal, tmp_path, {3: 99})
    done = dict(run_each(work, range(8), workers=2, lost=lambda job: job + 1000))
    assert done == {job: -job for job in range(8)} | {3: 1003}
    began = Counter(path.name.partition("-")[0] for path in tmp_path.iterdir())
    assert began.pop("3") == 1 + MAX_LOSSES  # once with others, then alone
    assert max(began.values()) <= 2
    with pytest.raises(WorkerLost, match="job 0 of 2"):
        list(run_each(partial(mortal, tmp_path, {9: 99}), [9, 10], workers=2))


def test_the_only_worker_is_another_process_where_its_loss_must_be_survived(tmp_path: Path) -> None:
    assert dict(run_each(partial(mortal, tmp_path, {0: 1}), [0, 1], workers=1, lost=lambda _: 7)) == {0: 0, 1: -1}


def test_told_to_stop_it_begins_nothing_more(tmp_path: Path) -> None:
    for workers in (1, 2):
        assert list(run_each(partial(mortal, tmp_path, {}), range(9), workers=workers, stop=lambda: True)) == []
    assert not list(tmp_path.iterdir())


def test_told_to_stop_it_ends_what_runs() -> None:
    """Also where the terminal's interrupt reaches the workers too, which leave it to their parent."""
    stop = threading.Event()
    before = set(multiprocessing.active_children())  # of other tests
    threading.Timer(1.0, stop.set).start()
    assert list(run_each(time.sleep, [3600.0, 3600.0, 3600.0], workers=2, stop=stop.is_set)) == []
    assert not set(multiprocessing.active_children()) - before


def ignore_terminate(folder: Path, job: int) -> None:
    """Ignore SIGTERM, as a library may, and work for longer than the test."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    write_pid_and_sleep(folder, job)


def test_a_worker_that_ignores_the_request_to_end_is_killed(tmp_path: Path) -> None:
    before = set(multiprocessing.active_children())
    running = partial(ignore_terminate, tmp_path)
    assert list(run_each(running, [0, 1], workers=2, stop=lambda: len(list(tmp_path.glob("*.pid"))) == 2)) == []
    assert not set(multiprocessing.active_children()) - before
    assert not any(is_alive(int(path.read_text())) for path in tmp_path.glob("*.pid"))


def write_pid_and_sleep(folder: Path, job: int) -> None:
    """Write the worker's pid, whole at once, and work for longer than the test."""
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


def test_workers_end_with_a_parent_that_is_killed(tmp_path: Path) -> None:
    parent = multiprocessing.get_context("spawn").Process(target=run_sleepers, args=(tmp_path,))
    parent.start()
    try:
        until(lambda: len(list(tmp_path.glob("*.pid"))) == 2)
    finally:
        parent.kill()
        parent.join()
    until(lambda: not any(is_alive(int(path.read_text())) for path in tmp_path.glob("*.pid")))


def interrupted(job: int) -> int:
    os.kill(os.getpid(), signal.SIGINT)
    return job


def test_an_interrupt_that_reaches_a_worker_too_is_its_parent_s() -> None:
    assert sorted(run_each(interrupted, [1, 2], workers=2)) == [(0, 1), (1, 2)]


def test_a_scheduler_that_is_not_there_is_bad_input(free_port: int) -> None:
    pytest.importorskip("distributed")
    with pytest.raises(ConfigError, match="option --cluster"):
        list(run_each(math.sqrt, [4.0], cluster=f"tcp://127.0.0.1:{free_port}", cluster_timeout_s=1.0))
