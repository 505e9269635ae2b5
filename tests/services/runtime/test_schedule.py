"""Schedule of a process: a grid skips no step, and cycles do not overlap and do not drift."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from ltv_mpc.messages import ImuSample
from ltv_mpc.node import Cycle, Grid, OnMessage
from services.runtime.process_time import StepSchedule

PERIOD_NS = 300_000_000


@given(start=st.integers(-(10**12), 10**12), lateness=st.lists(st.integers(0, 10**10), max_size=20))
def test_a_grid_takes_every_multiple_of_its_period_however_late_each_step_is(start: int, lateness: list[int]) -> None:
    table = StepSchedule(Grid(PERIOD_NS))
    table.start(start)
    taken = []
    for late in lateness:
        assert table.next_ns is not None
        taken.append(table.next_ns)
        table.advance(table.next_ns + late)
    first = -(-start // PERIOD_NS)
    assert taken == [PERIOD_NS * k for k in range(first, first + len(lateness))]


def test_cycles_do_not_drift_and_after_a_slow_one_the_next_starts_at_its_end() -> None:
    table = StepSchedule(Cycle(PERIOD_NS))
    table.start(0)
    for k in range(1000):
        assert table.next_ns == k * PERIOD_NS
        table.advance(k * PERIOD_NS + 20_000_000)
    slow_ns = 1000 * PERIOD_NS + 710_000_000
    for ended_ns, next_ns in ((slow_ns, slow_ns), (slow_ns + 10_000_000, slow_ns + PERIOD_NS)):
        table.advance(ended_ns)
        assert table.next_ns == next_ns


def test_cycles_wait_for_what_was_measured_at_their_instant_and_a_grid_does_not() -> None:
    table = StepSchedule(Cycle(PERIOD_NS))
    table.start(-1, phase_ns=60_000_000)
    assert table.next_ns == 60_000_000
    table.advance(70_000_000)
    assert table.next_ns == PERIOD_NS + 60_000_000
    grid = StepSchedule(Grid(PERIOD_NS))
    grid.start(-1, phase_ns=60_000_000)
    assert grid.next_ns == 0


def test_messages_need_no_timetable_and_a_grid_ends_after_its_last_step() -> None:
    on_message = StepSchedule(OnMessage((ImuSample,)))
    on_message.start(0)
    assert on_message.next_ns is None
    grid = StepSchedule(Grid(10), end_ns=20)
    grid.start(0)
    ends = []
    for t in (0, 10, 20):
        ends.append(grid.finished)
        grid.advance(t)
    assert [*ends, grid.finished] == [False, False, False, True]
