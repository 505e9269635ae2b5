"""Adaptive clock speed: as fast as the machine can, up to the requested speed."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise

import pytest

from ltv_mpc.messages import Clock, RunEvent
from services.runtime.clock import VehicleClock
from services.runtime.clock_master import (
    FIRST_WINDOW_US,
    GROWTH,
    MAX_SLIP_RATIO,
    WINDOW_US,
    ClockMaster,
    ClockMasterSettings,
    ClockRate,
)
from services.runtime.node_status import MAX_BACKLOG_US
from tests.services.words import status

ASKED = Fraction(10)


def found(asked: Fraction) -> ClockRate:
    """Return a clock rate that has reached its requested speed."""
    pace, now_us = ClockRate(asked), 0
    while pace.speed < asked:
        now_us += FIRST_WINDOW_US
        pace.window_over(now_us)
    return pace


def windows(pace: ClockRate, *given_up_us: int) -> list[float]:
    """Return the speed after each window."""
    pace.restart_window()
    pace.window_over(0)
    speeds = []
    for i, us in enumerate(given_up_us, 1):
        pace.add_slip(us)
        pace.window_over(i * WINDOW_US)
        speeds.append(float(pace.speed))
    return speeds


def test_slips_lower_the_speed_to_what_the_machine_can_do() -> None:
    assert windows(found(ASKED), int(0.3 * WINDOW_US)) == [pytest.approx(7.0)]
    assert windows(found(ASKED), 10 * WINDOW_US) == [5.0]  # at most half at once


def test_a_hiccup_changes_nothing_and_quiet_brings_the_speed_back() -> None:
    few = int(MAX_SLIP_RATIO * WINDOW_US)
    pace = found(ASKED)
    assert windows(pace, few, few + 1) == [10.0, pytest.approx(9.5, abs=1e-3)]
    speeds = windows(pace, *[0] * 10)
    assert speeds[0] == pytest.approx(9.5 * float(GROWTH), abs=1e-2)
    assert speeds[-1] == 10.0
    pace = found(ASKED)
    assert windows(pace, 0, 0) == [10.0, 10.0]


def test_the_speed_is_not_lowered_below_real_time() -> None:
    assert windows(found(Fraction(3, 2)), WINDOW_US, WINDOW_US) == [1.0, 1.0]
    assert windows(found(Fraction(1, 2)), WINDOW_US) == [0.5]


def test_the_speed_starts_at_real_time_and_doubles_until_slips_or_the_request() -> None:
    def speeds(asked: Fraction, *given_up_us: int) -> list[float]:
        pace, now_us, of = ClockRate(asked), 0, []
        pace.window_over(now_us)
        for us in given_up_us:
            of.append(float(pace.speed))
            pace.add_slip(us)
            now_us += FIRST_WINDOW_US
            pace.window_over(now_us)
        return [*of, float(pace.speed)]

    assert speeds(ASKED, 0, 0, 0, 0) == [1.0, 2.0, 4.0, 8.0, 10.0]
    too_much = FIRST_WINDOW_US // 4
    assert speeds(ASKED, 0, 0, too_much, 0) == [1.0, 2.0, 4.0, 3.0, 3.0]  # from there by long windows
    assert speeds(ASKED, 0, 1, 0) == [1.0, 2.0, 2.0, 4.0]  # a hiccup is waited for
    assert speeds(ASKED, too_much, 0) == [1.0, 1.0, 1.0]
    assert speeds(Fraction(1, 2), 0, 0) == [0.5, 0.5, 0.5]


def test_a_higher_request_is_approached_and_a_lower_one_holds_at_once() -> None:
    pace = found(Fraction(4))
    pace.request(Fraction(20))
    assert pace.speed == 4
    pace.window_over(0)
    assert pace.window_over(FIRST_WINDOW_US)
    assert pace.speed == 8
    pace.request(Fraction(3))
    assert pace.speed == 3
    assert not pace.window_over(10**9)
    assert not pace.window_over(2 * 10**9)


def test_another_requested_speed_starts_a_new_window() -> None:
    pace = found(ASKED)
    windows(pace, WINDOW_US)
    pace.request(Fraction(4))
    assert pace.speed == 4
    assert not pace.window_over(10 * WINDOW_US)  # where the window begins
    assert not pace.window_over(11 * WINDOW_US - 1)


class Machine:
    """Machine that does ``can`` vehicle seconds of work in one second; its node reports the queue delay every 50 ms."""

    def __init__(self, can: float) -> None:
        self._can = can
        self.said: list[Clock | RunEvent] = []
        self.clock = VehicleClock()
        settings = ClockMasterSettings(start_ns=0, end_ns=10**15, speed=float(ASKED), expects=())
        self.keeping = ClockMaster(settings, self.clock, epoch=1, now_us=0, publish=self.said.append)
        self.keeping.run_due(0)
        self.now_us = 0
        self._done_ns = 0.0
        self.waits_us: list[float] = []

    def run(self, wall_us: int, step_us: int = 5_000) -> None:
        """Let wall time pass."""
        for _ in range(wall_us // step_us):
            self.now_us += step_us
            self.keeping.run_due(self.now_us)
            asked_ns = self.clock.read(self.now_us) or 0
            self._done_ns = min(asked_ns, self._done_ns + self._can * step_us * 1000)
            min_queue_delay_us = (asked_ns - self._done_ns) / self._can / 1000
            self.waits_us.append(min_queue_delay_us)
            if min_queue_delay_us > MAX_BACKLOG_US and not self.now_us % 50_000:
                self.keeping.on_status(
                    status("estimator", min_queue_delay_us=int(min_queue_delay_us)), self.now_us, "plant"
                )


def test_on_a_machine_with_a_third_of_the_speed_messages_soon_stop_queueing() -> None:
    """Slips alone would leave a median queue delay of a third of a second."""
    machine = Machine(3.0)
    machine.run(3_000_000)
    begun_ns, begun_us = machine.clock.read(machine.now_us), machine.now_us
    machine.waits_us.clear()
    machine.run(10_000_000)
    ended_ns = machine.clock.read(machine.now_us)
    assert begun_ns is not None
    assert ended_ns is not None
    waits = sorted(machine.waits_us)
    assert waits[len(waits) // 2] < MAX_BACKLOG_US
    assert waits[-len(waits) // 100] < 5 * MAX_BACKLOG_US
    assert (ended_ns - begun_ns) / 1e3 / (machine.now_us - begun_us) > 0.9 * 3.0


def test_from_the_first_second_on_no_message_waits_long() -> None:
    """At ten times real time from the start the delay would be 0.3 s, three seconds of vehicle time."""
    machine = Machine(3.0)
    machine.run(3_000_000)
    assert max(machine.waits_us) < 150_000


def test_a_fast_machine_reaches_the_requested_speed() -> None:
    machine = Machine(12.0)
    machine.run(3_000_000)
    newest = next(one for one in reversed(machine.said) if isinstance(one, Clock))
    assert (newest.speed_num, newest.speed_den, newest.requested_speed) == (10, 1, 10.0)


def test_repeated_slips_are_reported_ever_more_rarely() -> None:
    """Each event is a mark on the time axis of every figure."""
    machine = Machine(3.0)
    machine.run(60_000_000)
    told = [one.text for one in machine.said if isinstance(one, RunEvent)]
    times = [int(text.partition("waits of the clock so far: ")[2].partition(",")[0]) for text in told]
    assert all(later >= 2 * earlier for earlier, later in pairwise(times))
    assert len(times) >= 4
