"""Queue of periodic duties: order, next deadline, and deadlines that are brought forward."""

from __future__ import annotations

from services.runtime.deadlines import DeadlineQueue


class Duty:
    """A duty that records when it ran and is due again after its period."""

    def __init__(self, due_us: int | None, period_us: int = 100) -> None:
        self.due_us = due_us
        self.period_us = period_us
        self.ran_us: list[int] = []

    def run(self, now_us: int) -> None:
        self.ran_us.append(now_us)
        self.due_us = now_us + self.period_us


def queue_of(*duties: Duty) -> DeadlineQueue:
    queue = DeadlineQueue()
    for duty in duties:
        queue.add(lambda duty=duty: duty.due_us, duty.run)
    return queue


def test_only_duties_whose_deadline_has_passed_run():
    early, late = Duty(10), Duty(11)
    queue_of(early, late).run_due(10)
    assert (early.ran_us, late.ran_us) == ([10], [])


def test_the_next_deadline_is_the_earliest_of_all_duties_and_of_the_step():
    queue = queue_of(Duty(30), Duty(20), Duty(None))
    assert queue.next_us() == 20
    assert queue.next_us(15) == 15
    assert queue.next_us(25) == 20


def test_a_duty_without_a_deadline_never_runs():
    idle, other = Duty(None), Duty(0)
    queue_of(idle, other).run_due(10**12)
    assert (idle.ran_us, other.ran_us) == ([], [10**12])


def test_a_deadline_that_is_brought_forward_is_kept():
    duty = Duty(0, period_us=1000)
    queue = queue_of(duty)
    queue.run_due(0)
    duty.due_us = 50
    assert queue.next_us() == 50
    queue.run_due(50)
    assert duty.ran_us == [0, 50]
