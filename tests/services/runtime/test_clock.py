"""Vehicle clock: exact integers, one time for all followers, no step back, and a speed that the machine can keep."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise

import msgspec
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from ltv_mpc.messages import Clock, ClockCommand, ClockState, RunEvent
from services.runtime.clock import MAX_SEGMENTS, ClockError, ClockSegment, VehicleClock
from services.runtime.clock_master import (
    FIRST_WINDOW_US,
    GROWTH,
    LEAD_US,
    MAX_CATCH_UP_US,
    MAX_SLIP_RATIO,
    WINDOW_US,
    ClockMaster,
    ClockMasterSettings,
    ClockRate,
)
from services.runtime.node_status import MAX_BACKLOG_US
from tests.services.words import status

START_NS = -1_000_000_000
T0_US, S_US = 50_000_000, 1_000_000
BEGIN_US = T0_US + LEAD_US
"""Instant at which a clock that waits for no node begins."""


class Kept:
    """Clock master without a bus, at wall times that the tests set (us)."""

    def __init__(self, *expects: str, speed: float = 1.0) -> None:
        self.sent: list[Clock | RunEvent] = []
        self.clock = VehicleClock()
        settings = ClockMasterSettings(start_ns=START_NS, end_ns=10**15, speed=speed, expects=expects)
        self.master = ClockMaster(settings, self.clock, node="plant", epoch=1, now_us=T0_US, publish=self.sent.append)
        self.sent.append(self.master.message)
        self.master.run_due(T0_US)

    def ask(self, now_us: int, *, paused: bool = False, speed: float = 1.0) -> None:
        self.master.on_command(ClockCommand(paused=paused, speed=speed), now_us)

    @property
    def events(self) -> list[str]:
        return [one.text for one in self.sent if isinstance(one, RunEvent)]


def follower(kept: Kept) -> VehicleClock:
    """Return a clock that has received what the master has announced."""
    clock = VehicleClock()
    for message in kept.sent:
        if isinstance(message, Clock):
            clock.follow(message)
    return clock


# --- followers -------------------------------------------------------------------------------------------------------


def test_the_clock_starts_when_the_last_expected_node_is_ready() -> None:
    kept = Kept("sensors", "controller")
    for node, waits in (("controller", "sensors"), ("sensors", "")):
        assert kept.clock.read(T0_US + 10 * S_US) == START_NS
        assert kept.clock.due_us(START_NS) is None
        kept.master.on_status(status(node), T0_US)
        kept.master.run_due(T0_US + 2)
        assert kept.master.waiting_for == waits
    begin_us = T0_US + 2 + LEAD_US
    assert kept.clock.due_us(START_NS) == begin_us
    assert kept.clock.read(begin_us - 1) == START_NS
    assert kept.clock.read(begin_us + S_US) == START_NS + 10**9


def test_a_pause_and_another_speed_are_announced_ahead_and_the_time_has_no_jump() -> None:
    kept = Kept()
    kept.ask(T0_US + S_US, paused=True)
    still_ns = START_NS + 10**9
    read = [kept.clock.read(BEGIN_US + at_us) for at_us in (S_US - 1, S_US, 5 * S_US)]
    assert read == [still_ns - 1000, still_ns, still_ns]
    assert kept.clock.due_us(still_ns + 1) is None
    kept.ask(T0_US + 6 * S_US, speed=0.5)
    bend_us = BEGIN_US + 6 * S_US
    assert [kept.clock.read(bend_us + at_us) for at_us in (-1, 0, 2 * S_US)] == [still_ns, still_ns, still_ns + 10**9]


@given(
    at=st.integers(0, 2**40),
    vehicle=st.integers(-(2**50), 2**50),
    num=st.integers(1, 10**6),
    den=st.integers(1, 10**6),
    ahead=st.integers(1, 2**50),
)
def test_due_is_the_first_microsecond_of_a_time_and_a_reading_is_exact_to_the_nanosecond_below(
    at: int, vehicle: int, num: int, den: int, ahead: int
) -> None:
    line = ClockSegment(at, vehicle, num, den, ClockState.RUNNING)
    due = line.due_us(vehicle + ahead)
    assert due is not None
    assert line.read(due) >= vehicle + ahead > line.read(due - 1)
    assert 0 <= Fraction(ahead * 1000 * num, den) + vehicle - line.read(at + ahead) < 1


@given(
    changes=st.lists(
        st.tuples(
            st.integers(1, 400_000),  # us since the change before
            st.sampled_from(("pause", "run", "slip")),
            st.floats(0.01, 1000),
            st.integers(0, 300_000),  # us until a follower hears of it
            st.booleans(),  # never heard at all
        ),
        max_size=12,
    ),
    waits=st.lists(st.integers(1, 90_000), min_size=5, max_size=60),
)
@example(  # a slip right behind a pause: the follower reads before it, the master does not
    changes=[(12_575, "pause", 1.0, 0, False), (1, "run", 1.0, 0, False), (2209, "slip", 1.0, 25, False)],
    waits=[1, 1, 1, 64_771, 16],
)
def test_no_follower_steps_back_and_timely_ones_read_the_clock_master_s_time(changes, waits) -> None:
    kept = Kept()
    now_us, timely, late = T0_US, [], []
    for wait_us, what, speed, delay_us, lost in changes:
        now_us += wait_us
        kept.sent.clear()
        kept.master.run_due(now_us)
        if what == "slip":
            kept.master.slip(now_us, int(speed * 100))
        else:
            kept.ask(now_us, paused=what == "pause", speed=speed)
        clocks = [one for one in kept.sent if isinstance(one, Clock)]
        timely += [(now_us, one) for one in clocks]
        late += [(now_us + delay_us, one) for one in clocks if not lost]
    late.sort(key=lambda pair: pair[0])
    readings = []
    for messages in (timely, late):
        clock, at_us, read = follower(Kept()), T0_US, []
        for wait_us in waits:
            at_us += wait_us
            while messages and messages[0][0] <= at_us:
                clock.follow(messages.pop(0)[1])
            read.append(clock.read(at_us) or START_NS)
        assert all(a <= b for a, b in pairwise(read))
        readings.append((at_us, read[-1]))
    if at_us >= now_us:  # the master itself has announced all that the timely follower knows
        assert readings[0][1] == kept.clock.read(at_us)


def test_the_time_at_an_instant_does_not_depend_on_earlier_readings() -> None:
    kept = Kept()
    kept.master.slip(T0_US + S_US, 300_000)
    kept.ask(T0_US + 2 * S_US, speed=0.5)
    clock, fresh = follower(kept), follower(kept)
    instants = range(T0_US, T0_US + 3 * S_US, 10_000)
    times = [clock.at(instant) for instant in instants]
    assert clock.at(T0_US - 10_000) == START_NS
    assert clock.at(BEGIN_US + S_US // 2) == START_NS + 500_000_000
    assert times == sorted(times)  # type: ignore[type-var]
    readings = [fresh.read(instant) for instant in instants]  # which hold at the last one before a line's end
    assert all(0 <= time - reading <= 10_000_000 for time, reading in zip(times, readings, strict=True))  # type: ignore[operator]
    clock.read(T0_US + 1_500_000)  # lines that are over are remembered
    assert clock.at(T0_US + 1_500_000) == times[150]
    assert VehicleClock().at(T0_US) is None


def test_the_number_of_announced_segments_is_bounded() -> None:
    kept = Kept()
    clock = follower(kept)
    for i in range(10_000):
        at_us = T0_US + 10**9 + i
        clock.follow(msgspec.structs.replace(kept.master.message, clock_sequence=i + 2, at_monotonic_us=at_us))
    assert len(clock._segments) == MAX_SEGMENTS
    assert clock.newest is not None
    assert clock.newest.at_us == T0_US + 10**9 + 9_999
    assert clock.read(BEGIN_US + S_US) == START_NS + 10**9


@pytest.mark.parametrize(
    ("change", "problem"), [({"host_boot_id": "other"}, "another host"), ({"clock_epoch": 2}, "another plant")]
)
def test_a_clock_of_another_host_or_plant_is_an_error_with_its_reason(change, problem) -> None:
    clock = follower(kept := Kept())
    with pytest.raises(ClockError, match=problem):
        clock.follow(msgspec.structs.replace(kept.master.message, clock_sequence=9, **change))


def test_a_speed_that_differs_from_the_clock_master_s_is_an_error_that_names_both() -> None:
    kept, same = Kept(speed=2.5), VehicleClock(speed=2.5)
    same.follow(kept.master.message)
    with pytest.raises(ClockError, match=r"5 here and 2\.5 at the plant"):
        VehicleClock(speed=5).follow(kept.master.message)
    kept.ask(T0_US, speed=7)
    assert same.follow(kept.master.message)  # a change on the way is none


# --- commands and slips of the clock master --------------------------------------------------------------------------


def test_only_changes_are_announced_and_each_is_an_event() -> None:
    kept = Kept()
    count = len(kept.sent)
    kept.ask(T0_US + S_US)
    assert len(kept.sent) == count
    for _ in range(2):
        kept.ask(T0_US + 2 * S_US, paused=True, speed=4.0)
    assert kept.events == ["clock at 4 x real time, paused, as requested"]


def test_a_command_neither_starts_the_clock_nor_continues_it_after_the_end() -> None:
    waiting, ended = Kept("controller"), Kept()
    for paused, speed in ((False, 1.0), (True, 4.0)):
        waiting.ask(T0_US + S_US, paused=paused, speed=speed)
    assert waiting.master.message.state is ClockState.WAITING
    assert waiting.master.message.requested_speed == 4.0
    ended.master.stop(T0_US + S_US)
    ended.ask(T0_US + 2 * S_US)
    assert ended.master.message.state is ClockState.PAUSED


def test_the_clock_slips_when_a_grid_is_late_by_more_than_a_tenth_of_a_second() -> None:
    kept, now_us = Kept(), T0_US + 5 * S_US
    for at_us, late_us, sent in (
        (now_us, MAX_CATCH_UP_US, 0),
        (now_us, MAX_CATCH_UP_US + 30_000, 2),  # the clock, and an event that counts
        (now_us + 1, 900_000, 0),  # the change is on its way already
        (now_us + LEAD_US + 29_999, 900_000, 0),  # and has not passed yet
        (now_us + LEAD_US + 30_000, 900_000, 1),  # counted, and told again after a second only
    ):
        kept.sent.clear()
        kept.master.on_late_step(at_us, at_us - late_us)
        assert len(kept.sent) == sent
    assert kept.master.slips == 2


def test_the_clock_slips_for_a_node_that_cannot_keep_up_and_readings_hold_still_meanwhile() -> None:
    """An estimator whose inputs wait longer and longer: the clock slips by the newest waiting time."""
    kept, now_us = Kept("estimator", speed=0.5), T0_US + 5 * S_US
    kept.master.on_status(status("estimator", min_queue_delay_us=10**9), T0_US)
    kept.master.run_due(T0_US)
    kept.sent.clear()
    kept.master.on_status(status("estimator", min_queue_delay_us=MAX_BACKLOG_US), now_us)
    assert kept.sent == []
    before_ns = kept.clock.at(now_us + S_US)
    kept.master.on_status(status("estimator", min_queue_delay_us=MAX_BACKLOG_US + 30_000), now_us)
    assert [type(one) for one in kept.sent] == [Clock, RunEvent]
    held = [kept.clock.read(now_us + LEAD_US + after_us) for after_us in (-1, 0, 49_000)]
    assert held == [START_NS + 2_500_000_000 - 500, *[START_NS + 2_500_000_000] * 2]
    assert before_ns is not None
    assert kept.clock.at(now_us + S_US) == before_ns - 25_000_000
    assert (kept.master.slips, kept.master.slipped_ns) == (1, 25_000_000)


# --- the speed that the machine can keep -----------------------------------------------------------------------------

FEW, FIRST_FEW = int(MAX_SLIP_RATIO * WINDOW_US), FIRST_WINDOW_US // 4


@pytest.mark.parametrize(
    ("asked", "slipped_us", "speeds"),
    [
        (10, (0, 0, 0, 0), [2, 4, 8, 10]),
        (10, (0, 0, FIRST_FEW, 0), [2, 4, 3, 3]),  # from there by long windows
        (10, (0, 1, 0), [2, 2, 4]),  # a hiccup is waited for
        (10, (FIRST_FEW, 0), [1, 1]),
        (0.5, (0, 0), [0.5, 0.5]),
    ],
)
def test_the_speed_starts_at_real_time_and_doubles_until_slips_or_the_request(asked, slipped_us, speeds) -> None:
    rate = ClockRate(Fraction(asked))
    assert rate.speed == min(asked, 1)
    rate.window_over(0)
    assert [after(rate, number * FIRST_WINDOW_US, us) for number, us in enumerate(slipped_us, 1)] == speeds


def after(rate: ClockRate, now_us: int, slipped_us: int = 0) -> float:
    """Return the speed after a window that ends at ``now_us``."""
    rate.add_slip(slipped_us)
    rate.window_over(now_us)
    return float(rate.speed)


def found(asked: Fraction) -> ClockRate:
    """Return a clock rate that has reached its requested speed, at the begin of a window."""
    rate, now_us = ClockRate(asked), 0
    while rate.speed < asked:
        now_us += FIRST_WINDOW_US
        rate.window_over(now_us)
    rate.restart_window()
    rate.window_over(0)
    return rate


@pytest.mark.parametrize(
    ("asked", "slipped_us", "speeds"),
    [
        (Fraction(10), (int(0.3 * WINDOW_US),), [7.0]),
        (Fraction(10), (10 * WINDOW_US,), [5.0]),  # at most half at once
        (Fraction(10), (0, FEW, FEW + 1, 0, *[0] * 9), [10.0, 10.0, 9.5, 9.5 * float(GROWTH), *[None] * 8, 10.0]),
        (Fraction(3, 2), (WINDOW_US, WINDOW_US), [1.0, 1.0]),  # never below real time
        (Fraction(1, 2), (WINDOW_US,), [0.5]),
    ],
)
def test_slips_lower_the_speed_to_what_the_machine_can_do_and_quiet_brings_it_back(asked, slipped_us, speeds) -> None:
    rate = found(asked)
    for number, (us, speed) in enumerate(zip(slipped_us, speeds, strict=True), 1):
        reached = after(rate, number * WINDOW_US, us)
        assert speed is None or reached == pytest.approx(speed, abs=1e-2)


def test_a_higher_request_is_approached_and_a_lower_one_holds_at_once_with_a_new_window() -> None:
    rate = found(Fraction(4))
    rate.add_slip(WINDOW_US)
    rate.request(Fraction(20))
    assert rate.speed == 4
    assert not rate.window_over(10 * WINDOW_US)  # where the window begins
    assert after(rate, 10 * WINDOW_US + FIRST_WINDOW_US) == 8
    rate.request(Fraction(3))
    assert rate.speed == 3
    assert not rate.window_over(10**9)
    assert not rate.window_over(2 * 10**9)


class Machine:
    """Machine that does ``can`` vehicle seconds of work in one second; its node reports the queue delay every 50 ms."""

    def __init__(self, can: float) -> None:
        self.can, self.kept, self.now_us = can, Kept(speed=10.0), T0_US
        self.waits_us: list[float] = []
        self._done_ns = float(START_NS)

    def run(self, wall_us: int, step_us: int = 5_000) -> None:
        """Let wall time pass."""
        master = self.kept.master
        for _ in range(wall_us // step_us):
            self.now_us += step_us
            master.run_due(self.now_us)
            asked_ns = self.kept.clock.read(self.now_us)
            assert asked_ns is not None
            self._done_ns = min(asked_ns, self._done_ns + self.can * step_us * 1000)
            wait_us = (asked_ns - self._done_ns) / self.can / 1000
            self.waits_us.append(wait_us)
            if wait_us > MAX_BACKLOG_US and not self.now_us % 50_000:
                master.on_status(status("estimator", min_queue_delay_us=int(wait_us)), self.now_us)


def test_on_a_machine_with_a_third_of_the_speed_messages_soon_stop_queueing_and_slips_are_reported_rarely() -> None:
    """Slips alone would leave a median queue delay of a third of a second. Each event is a mark in every figure."""
    machine = Machine(3.0)
    machine.run(3 * S_US)
    assert max(machine.waits_us) < 150_000  # at ten times real time from the start it would be 0.3 s
    machine.waits_us.clear()
    begun_us, begun_ns = machine.now_us, machine.kept.clock.read(machine.now_us)
    machine.run(10 * S_US)
    ended_ns = machine.kept.clock.read(machine.now_us)
    assert begun_ns is not None
    assert ended_ns is not None
    waits = sorted(machine.waits_us)
    assert waits[len(waits) // 2] < MAX_BACKLOG_US
    assert waits[-len(waits) // 100] < 5 * MAX_BACKLOG_US
    assert (ended_ns - begun_ns) / 1e3 / (machine.now_us - begun_us) > 0.9 * 3.0
    machine.run(47 * S_US)
    times = [int(text.partition("waits of the clock so far: ")[2].partition(",")[0]) for text in machine.kept.events]
    assert all(later >= 2 * earlier for earlier, later in pairwise(times))
    assert len(times) >= 4
