"""Restart policy: restart or end of the run, the restart budget, and when a process is back."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import msgspec
import pytest

from services.supervisor.bus_monitor import Activity
from services.supervisor.process_group import Failure, ProcessGroup, RunFailed
from services.supervisor.process_table import ProcessRow
from tests.waiting import until

NOTHING = cast(Any, None)


class Nothing(msgspec.Struct):
    """Config of a process that does not exist."""


@pytest.fixture
def crew(tmp_path: Path) -> Iterator[ProcessGroup]:
    crew = ProcessGroup(tmp_path / "scenario.toml", tmp_path, NOTHING)
    yield crew
    crew.stop(in_order=False, close_session=lambda: None)


def test_at_most_five_restarts_count_within_a_minute_and_a_denied_one_never(crew: ProcessGroup) -> None:
    times_s = (0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 59.9, 60.0, 60.5, 61.0)
    assert [crew.may_restart(t) for t in times_s] == [True] * 5 + [False] * 2 + [True, False, True]


@pytest.mark.parametrize(
    ("restartable", "ready", "restarts", "why", "in_order"),
    [
        (False, True, 0, "", False),
        (True, False, 0, "", False),
        (True, True, 5, "; the limit of 5 restarts within 60 s is reached: stopping safely", True),
    ],
)
def test_what_may_not_be_restarted_ends_the_run_with_its_last_lines(
    crew: ProcessGroup, restartable: bool, ready: bool, restarts: int, why: str, in_order: bool
) -> None:
    crew.all_ready = ready
    for _ in range(restarts):
        crew.may_restart(time.monotonic())
    crew.start(ProcessRow("estimator", "no.such.module", restartable), Nothing())
    until(lambda: crew.by_name["estimator"].exit_code() is not None)
    with pytest.raises(RunFailed) as failed:
        crew.check(time.monotonic())
    assert failed.value.why == f"estimator ended with exit code 1{why}"
    assert "'no'" in failed.value.last_lines[-1]
    assert failed.value.in_order == in_order


@pytest.mark.parametrize(
    ("old_epoch", "epoch", "arrived_s", "over"),
    [
        (7, 7, 10.4, False),  # of its former self, on its way
        (7, 8, 10.05, False),
        (7, 8, 10.4, True),
        (0, 0, 10.05, False),  # a router has no epoch
        (0, 0, 10.2, True),
    ],
)
def test_a_process_is_back_with_the_first_message_of_another_epoch(old_epoch, epoch, arrived_s, over) -> None:
    failure = Failure("was ended by SIGKILL", 9.9, old_epoch, restarted_s=10.1)
    assert failure.is_over(Activity(epoch, arrived_s)) == over
