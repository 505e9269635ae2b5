"""Time of a process: a grid skips no step, cycles do not overlap and do not drift, and nothing is from the future."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from ltv_mpc.messages import Clock, Estimate, ImuSample, Message, Obstacles
from ltv_mpc.node import Cycle, Grid, OnMessage
from services.runtime.process_time import ClockOptions, ProcessTime, StepSchedule
from tests.services.bus.messages import SHIP
from tests.services.words import running_clock

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


@pytest.mark.parametrize("time_by", [running_clock(0), Estimate.at_rest()], ids=["clock", "stamps"])
def test_obstacles_from_the_future_do_not_fit_the_time_with_the_reason(time_by: Message) -> None:
    """As with stamps in UTC, where vehicle time began at 0; those with vehicle time fit."""
    node: Any = SimpleNamespace(name="controller", schedule=Cycle(PERIOD_NS))
    time = ProcessTime(node, ClockOptions(sync_to_inputs=True), epoch=1, publish=lambda _: None)
    for now_us in range(0, 3_000_000, 100_000):
        now_ns = now_us * 1000
        message = time_by if isinstance(time_by, Clock) else replace(time_by, t_ns=now_ns)
        assert time.take(message, 5, now_us) == ""
    fits, ahead = (
        Obstacles(t_ns=t_ns, obstacles=(replace(SHIP, t_ns=t_ns),)) for t_ns in (now_ns, 1_700_000_000_000_000_000)
    )
    assert time.take(fits, 6, now_us) == ""
    reason = time.take(ahead, 6, now_us)
    assert reason.startswith(f"t_ns of an obstacle is ahead of the vehicle's time: obstacle {SHIP.id}, by ")
