"""Restart policy: restart or end of the run, the restart budget, and the processes it is for."""

from __future__ import annotations

from services.supervisor.restarts import (
    MAX_RESTARTS,
    WINDOW_S,
    ProcessFailure,
    Recovery,
    RestartBudget,
    restart_refusal,
)


def fault(at_s: float = 10.0, node: str = "estimator") -> ProcessFailure:
    return ProcessFailure(node, "was ended by SIGKILL", at_s - 0.1, at_s)


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


def test_a_restartable_process_that_has_worked_is_restarted() -> None:
    assert restart_refusal(fault(), restartable=True, had_started=True, budget=RestartBudget()) is None


def test_plant_and_sensors_are_not_restarted_and_cost_no_restart() -> None:
    budget = RestartBudget(max_restarts=1)
    refusal = restart_refusal(fault(node="plant"), restartable=False, had_started=True, budget=budget)
    assert refusal is not None
    assert refusal.why == "plant was ended by SIGKILL"
    assert not refusal.in_order
    assert budget.spend(0.0)


def test_a_process_that_fails_before_it_was_ready_is_not_restarted() -> None:
    assert restart_refusal(fault(), restartable=True, had_started=False, budget=RestartBudget()) is not None


def test_without_a_restart_left_the_run_ends_in_order_and_says_why() -> None:
    budget = RestartBudget(max_restarts=1)
    assert restart_refusal(fault(1.0), restartable=True, had_started=True, budget=budget) is None
    refusal = restart_refusal(fault(2.0), restartable=True, had_started=True, budget=budget)
    assert refusal is not None
    assert refusal.in_order
    assert "estimator was ended by SIGKILL" in refusal.why
    assert "stopping safely" in refusal.why


def test_a_process_is_back_with_the_first_message_of_another_epoch() -> None:
    recovery = Recovery(fault(10.0), old_epoch=7, started_s=10.1)
    assert not recovery.is_over(7, 10.4)  # one of its former self, that was on its way
    assert recovery.is_over(8, 10.4)
    assert not recovery.is_over(8, 10.05)


def test_a_process_without_an_epoch_is_back_with_its_first_message() -> None:
    recovery = Recovery(fault(10.0, "router"), old_epoch=0, started_s=10.1)
    assert not recovery.is_over(0, 10.05)
    assert recovery.is_over(0, 10.2)
