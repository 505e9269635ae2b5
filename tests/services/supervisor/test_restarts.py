"""Restart policy: restart or end of the run, the restart budget, and when a process is back."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest

from services.supervisor.child_processes import ChildProcesses
from services.supervisor.failure_handler import (
    MAX_RESTARTS,
    WINDOW_S,
    FailureHandler,
    ProcessFailure,
    Recovery,
    RestartBudget,
    RunFailed,
)
from services.supervisor.parent_death import OrphanCleanup
from services.supervisor.process_table import ProcessRow
from services.supervisor.screen import Screen
from tests.waiting import until


class NoScreen(Screen):
    """Screen that shows nothing."""


class Nothing(msgspec.Struct):
    """Config of a process that does not exist."""


@pytest.fixture
def crew(tmp_path: Path) -> Iterator[ChildProcesses]:
    cleanup = OrphanCleanup()
    crew = ChildProcesses(tmp_path / "scenario.toml", tmp_path, cleanup.group)
    yield crew
    for child in crew.by_name.values():
        child.kill()
        child.close()
    crew.forks.close()
    cleanup.close()


def failure_of(crew: ChildProcesses, *, restartable: bool, ready: bool, restarts: int = 0) -> RunFailed:
    """Return how the run ends when a process that ends at once is checked, after this number of restarts."""
    handler = FailureHandler(crew, NoScreen())
    handler.all_ready = ready
    for _ in range(restarts):
        handler._budget.spend(time.monotonic())
    crew.start(ProcessRow("estimator", "no.such.module", restartable), Nothing())
    until(lambda: crew.by_name["estimator"].exit_code() is not None)
    with pytest.raises(RunFailed) as failed:
        handler.check(time.monotonic())
    return failed.value


def test_five_restarts_within_a_minute_and_no_sixth() -> None:
    budget = RestartBudget()
    assert [budget.spend(float(t)) for t in range(7)] == [True] * 5 + [False] * 2
    assert (MAX_RESTARTS, WINDOW_S) == (5, 60.0)


def test_a_restart_counts_for_a_minute_and_a_denied_one_never() -> None:
    budget = RestartBudget()
    for t in (0.0, 1.0, 2.0, 3.0, 4.0):
        assert budget.spend(t)
    assert not budget.spend(59.9)
    assert budget.spend(60.0)
    assert not budget.spend(60.5)
    assert budget.spend(61.0)


def test_what_is_not_restartable_or_was_never_ready_ends_the_run_with_its_last_lines(crew: ChildProcesses) -> None:
    for restartable, ready in ((False, True), (True, False)):
        failed = failure_of(crew, restartable=restartable, ready=ready)
        assert failed.why == "estimator ended with exit code 1; its last lines:"
        assert "no.such" in failed.last_lines[-1] or "'no'" in failed.last_lines[-1]
        assert not failed.in_order


def test_without_a_restart_left_the_run_ends_in_order_and_says_why(crew: ChildProcesses) -> None:
    failed = failure_of(crew, restartable=True, ready=True, restarts=MAX_RESTARTS)
    assert failed.in_order
    assert failed.why.startswith("estimator ended with exit code 1; the limit of 5 restarts within 60 s is reached")
    assert "stopping safely" in failed.why


def recovery(node: str, old_epoch: int) -> Recovery:
    return Recovery(ProcessFailure(node, "was ended by SIGKILL", 9.9, 10.0), old_epoch=old_epoch, started_s=10.1)


def test_a_process_is_back_with_the_first_message_of_another_epoch() -> None:
    estimator = recovery("estimator", 7)
    assert not estimator.is_over(7, 10.4)  # one of its former self, that was on its way
    assert estimator.is_over(8, 10.4)
    assert not estimator.is_over(8, 10.05)


def test_a_process_without_an_epoch_is_back_with_its_first_message() -> None:
    router = recovery("router", 0)
    assert not router.is_over(0, 10.05)
    assert router.is_over(0, 10.2)
