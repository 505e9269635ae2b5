"""Queue of periodic duties: order, next deadline, and deadlines that are brought forward."""

from __future__ import annotations

from services.runtime.deadlines import DeadlineQueue


def test_duties_run_at_their_deadlines_which_may_be_brought_forward():
    due: dict[str, int | None] = {"late": 11, "early": 10, "never": None}
    ran: list[tuple[str, int]] = []

    def run(name: str, now_us: int) -> None:
        ran.append((name, now_us))
        due[name] = now_us + 1000

    queue = DeadlineQueue()
    for name in due:
        queue.add(lambda name=name: due[name], lambda now_us, name=name: run(name, now_us))
    assert [queue.next_us(step_us) for step_us in (None, 9, 15)] == [10, 9, 10]
    for now_us in (10, 12):
        queue.run_due(now_us)
    due["early"] = 50
    assert queue.next_us() == 50
    queue.run_due(50)
    assert ran == [("early", 10), ("late", 12), ("early", 50)]
