"""Vehicle clock: exact integers, the same time for all timely followers, and no step back for late ones."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ltv_mpc.messages import Clock, ClockState
from services.runtime.clock import (
    MAX_SEGMENTS,
    ClockError,
    ClockSegment,
    VehicleClock,
    fraction_of,
)
from services.runtime.clock_master import LEAD_US, MAX_CATCH_UP_US, ClockMaster, ClockMasterSettings, ClockSource
from services.runtime.node_status import MAX_BACKLOG_US
from tests.services.words import status

START_NS = -1_000_000_000
T0_US = 50_000_000


def keeper(speed: float = 10.0) -> ClockSource:
    return ClockSource(epoch=1, start_ns=START_NS, speed=speed, now_us=T0_US)


def follower(keeper: ClockSource) -> VehicleClock:
    clock = VehicleClock()
    clock.follow(keeper.message)
    return clock


def test_before_the_start_the_clock_holds_the_start_time_and_nothing_is_due() -> None:
    clock = follower(keeper())
    assert clock.read(T0_US + 10_000_000) == START_NS
    assert clock.due_us(START_NS) is None


def test_the_clock_runs_at_its_speed_from_the_announced_instant_on() -> None:
    k = keeper(2.5)
    clock = follower(k)
    clock.follow(k.run(T0_US))
    begin = T0_US + LEAD_US
    assert clock.read(begin - 1) == START_NS
    assert clock.due_us(START_NS) == begin
    assert clock.read(begin + 1_000_000) == START_NS + 2_500_000_000


def test_a_paused_clock_resumes_where_it_stopped() -> None:
    k = keeper(10)
    clock = follower(k)
    clock.follow(k.run(T0_US))
    clock.follow(k.pause(T0_US + 1_000_000))
    frozen = START_NS + 10_000_000_000  # 1 s of wall time ran, lead after lead
    assert clock.read(T0_US + 5_000_000) == frozen
    assert clock.due_us(frozen + 1) is None
    clock.follow(k.run(T0_US + 9_000_000))
    assert clock.read(T0_US + 9_000_000) == frozen
    assert clock.read(T0_US + 9_000_000 + LEAD_US + 100) == frozen + 1_000_000


def at_speed(k: ClockSource, now_us: int, speed: float) -> Clock:
    return k.set_speed(now_us, fraction_of(speed), requested=speed)


def test_a_change_of_speed_causes_no_jump() -> None:
    k = keeper(1)
    clock = follower(k)
    clock.follow(k.run(T0_US))
    clock.follow(at_speed(k, T0_US + 1_000_000, 20))
    bend = T0_US + 1_000_000 + LEAD_US
    at_bend = START_NS + 1_000_000_000
    assert [clock.read(bend + d) for d in (-1000, 0, 1000)] == [at_bend - 1_000_000, at_bend, at_bend + 20_000_000]


@given(
    at=st.integers(0, 2**40),
    vehicle=st.integers(-(2**50), 2**50),
    num=st.integers(1, 10**6),
    den=st.integers(1, 10**6),
    ahead=st.integers(1, 2**50),
)
def test_due_is_the_first_microsecond_at_which_the_time_is_reached(
    at: int, vehicle: int, num: int, den: int, ahead: int
) -> None:
    line = ClockSegment(at, vehicle, num, den, ClockState.RUNNING)
    due = line.due_us(vehicle + ahead)
    assert due is not None
    assert line.read(due) >= vehicle + ahead > line.read(due - 1)


@given(at=st.integers(0, 2**40), num=st.integers(1, 10**6), den=st.integers(1, 10**6), after=st.integers(0, 2**40))
def test_a_reading_is_exact_to_the_nanosecond_below(at: int, num: int, den: int, after: int) -> None:
    exact = Fraction(after * 1000 * num, den)
    assert 0 <= exact - ClockSegment(at, 0, num, den, ClockState.RUNNING).read(at + after) < 1


def test_the_time_at_an_instant_does_not_depend_on_earlier_readings() -> None:
    k = keeper(10)
    clock, fresh = follower(k), follower(k)
    for c in (clock, fresh):
        c.follow(k.message)
    for message in (k.run(T0_US), k.slip(T0_US + 1_000_000, 300_000), at_speed(k, T0_US + 2_000_000, 3)):
        clock.follow(message)
        fresh.follow(message)
    begin = T0_US + LEAD_US
    clock.at(T0_US * 1000)
    instants = range(T0_US, T0_US + 3_000_000, 10_000)
    times = [clock.at(instant) for instant in instants]
    assert clock.at(T0_US - 10_000) == START_NS
    assert clock.at(begin + 500_000) == START_NS + 5_000_000_000
    assert times == sorted(times)  # type: ignore[type-var]
    readings = [fresh.read(instant) for instant in instants]  # which hold at the last one before a line's end
    assert all(0 <= time - reading <= 100_000_000 for time, reading in zip(times, readings, strict=True))  # type: ignore[operator]
    clock.read(T0_US + 1_500_000)  # and lines that are over are remembered
    assert clock.at(T0_US + 1_500_000) == times[list(instants).index(T0_US + 1_500_000)]
    assert VehicleClock().at(T0_US) is None


CHANGES = st.lists(
    st.tuples(
        st.integers(1, 400_000),  # us since the change before
        st.sampled_from(("pause", "run", "speed", "slow")),
        st.floats(0.01, 1000),
        st.integers(0, 300_000),  # us until a follower hears of it
        st.booleans(),  # never heard at all
    ),
    max_size=12,
)


@given(changes=CHANGES, readings=st.lists(st.integers(1, 90_000), min_size=5, max_size=60))
def test_no_follower_steps_back_after_late_or_lost_announcements(
    changes: list[tuple[int, str, float, int, bool]], readings: list[int]
) -> None:
    k = keeper()
    now_us, heard = T0_US, []
    messages = [(T0_US, k.message), (T0_US, k.run(T0_US))]
    for wait, what, speed, delay, lost in changes:
        now_us += wait
        if what == "speed":
            message = at_speed(k, now_us, speed)
        elif what == "slow":
            message = k.slip(now_us, int(speed * 100))
        else:
            message = k.pause(now_us) if what == "pause" else k.run(now_us)
        if not lost:
            messages.append((now_us + delay, message))
    messages.sort(key=lambda pair: pair[0])
    clock, at_us = VehicleClock(), T0_US
    for wait in readings:
        at_us += wait
        while messages and messages[0][0] <= at_us:
            clock.follow(messages.pop(0)[1])
        reading = clock.read(at_us)
        if reading is not None:
            heard.append(reading)
    assert all(a <= b for a, b in pairwise(heard))


@given(changes=CHANGES)
def test_timely_followers_read_the_clock_master_s_time(changes: list[tuple[int, str, float, int, bool]]) -> None:
    k = keeper()
    own, other = follower(k), follower(k)
    now_us = T0_US
    start = k.run(T0_US)
    own.follow(start)
    other.follow(start)
    for wait, what, speed, delay, _ in changes:
        now_us += LEAD_US + wait
        own.read(now_us)
        message = (
            at_speed(k, now_us, speed) if what == "speed" else k.pause(now_us) if what == "pause" else k.run(now_us)
        )
        own.follow(message)
        other.follow(msgspec.structs.replace(message))
        at_us = now_us + min(delay, LEAD_US)
        assert own.read(at_us) == other.read(at_us)


def test_after_a_slip_readings_hold_still_until_the_clock_catches_up() -> None:
    k = keeper(10)
    clock = follower(k)
    clock.follow(k.run(T0_US))
    now_us = T0_US + 1_000_000
    before = clock.read(now_us + LEAD_US - 1)
    clock.follow(k.slip(now_us, 30_000))
    held = clock.read(now_us + LEAD_US)
    assert held is not None
    assert before is not None
    assert before <= held <= before + 10_000
    assert clock.read(now_us + LEAD_US + 20_000) == clock.read(now_us + LEAD_US)
    assert clock.read(now_us + LEAD_US + 40_000) == START_NS + 10_000 * (1_000_000 + 40_000 - 30_000)
    assert (k.slips, k.slipped_ns) == (1, 300_000_000)


def test_the_number_of_announced_segments_is_bounded() -> None:
    k = keeper(1.0)
    clock = follower(k)
    clock.follow(k.run(T0_US))
    for i in range(10_000):
        clock.follow(msgspec.structs.replace(k.message, clock_sequence=i + 2, at_monotonic_us=T0_US + 10**9 + i))
    assert len(clock._segments) == MAX_SEGMENTS
    assert clock.newest is not None
    assert clock.newest.at_us == T0_US + 10**9 + 9_999
    assert clock.read(T0_US + LEAD_US + 1_000_000) == START_NS + 1_000_000_000


def test_a_clock_of_another_host_or_plant_is_an_error_with_its_reason() -> None:
    clock = follower(keeper())
    with pytest.raises(ClockError, match="another host"):
        clock.follow(msgspec.structs.replace(keeper().message, host_boot_id="other", clock_sequence=1))
    with pytest.raises(ClockError, match="another plant"):
        clock.follow(msgspec.structs.replace(keeper().message, clock_epoch=2, clock_sequence=1))


def test_a_speed_that_differs_from_the_clock_master_s_is_an_error_that_names_both() -> None:
    VehicleClock(speed=2.5).follow(keeper(2.5).message)
    with pytest.raises(ClockError, match=r"5 here and 2\.5 at the plant"):
        VehicleClock(speed=5).follow(keeper(2.5).message)
    told = VehicleClock(speed=2.5)
    k = keeper(2.5)
    told.follow(k.message)
    told.follow(at_speed(k, T0_US, 7))  # a change on the way is none


def keeping_time(clock: VehicleClock, sent: list[object], *expects: str) -> ClockMaster:
    settings = ClockMasterSettings(start_ns=START_NS, end_ns=0, speed=10.0, expects=expects)
    return ClockMaster(settings, clock, epoch=1, now_us=T0_US, publish=sent.append)


def test_the_clock_starts_when_the_last_expected_node_is_ready() -> None:
    sent: list[object] = []
    clock = VehicleClock()
    keeping = keeping_time(clock, sent, "sensors", "controller")
    keeping.run_due(T0_US)
    keeping.on_status(status("controller"), T0_US, "plant")
    keeping.run_due(T0_US + 1)
    assert keeping.waiting_for == "sensors"
    assert clock.due_us(START_NS) is None
    keeping.on_status(status("sensors"), T0_US, "plant")
    keeping.run_due(T0_US + 2)
    assert clock.due_us(START_NS) == T0_US + 2 + LEAD_US


def test_the_clock_slips_when_a_grid_is_late_by_more_than_a_tenth_of_a_second() -> None:
    sent: list[object] = []
    clock = VehicleClock()
    keeping = keeping_time(clock, sent)
    keeping.run_due(T0_US)
    now_us = T0_US + 5_000_000
    keeping.on_late_step(now_us, now_us - MAX_CATCH_UP_US, "plant")
    assert len(sent) == 1
    keeping.on_late_step(now_us, now_us - MAX_CATCH_UP_US - 7_000, "plant")
    assert len(sent) == 3  # the clock, and an event that counts
    keeping.on_late_step(now_us + 1, now_us - 900_000, "plant")  # the change is on its way already
    assert len(sent) == 3
    keeping.on_late_step(now_us + LEAD_US + 6_999, now_us - 900_000, "plant")  # and has not passed yet
    assert len(sent) == 3
    keeping.on_late_step(
        now_us + LEAD_US + 7_000, now_us - 900_000, "plant"
    )  # counted, and told again after a second only
    assert len(sent) == 4


def test_the_clock_slips_for_a_node_that_cannot_keep_up() -> None:
    """An estimator whose inputs wait longer and longer: the clock slips by the newest waiting time."""
    sent: list[object] = []
    clock = VehicleClock()
    keeping = keeping_time(clock, sent, "estimator")
    keeping.on_status(status("estimator", min_queue_delay_us=10**9), T0_US, "plant")
    keeping.run_due(T0_US)
    begun = len(sent)
    now_us = T0_US + 5_000_000
    keeping.on_status(status("estimator", min_queue_delay_us=MAX_BACKLOG_US), now_us, "plant")
    assert len(sent) == begun
    before = clock.at(now_us + 10 * LEAD_US)
    keeping.on_status(status("estimator", min_queue_delay_us=MAX_BACKLOG_US + 30_000), now_us, "plant")
    assert len(sent) == begun + 2  # the clock, and an event that counts
    after = clock.at(now_us + 10 * LEAD_US)
    assert before is not None
    assert after is not None
    assert before - after == 50_000_000  # 50 ms of wall time at the speed that it begins with
