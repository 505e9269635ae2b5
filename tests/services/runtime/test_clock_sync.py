"""Synchronisation with another side's clock: the error bound holds for any delays."""

from __future__ import annotations

import heapq
import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import msgspec
import pytest

from ltv_mpc.messages import Applied, ClockMode, Estimate
from services.runtime.clock import ClockSource, VehicleClock
from services.runtime.clock_sync import GRACE_US, STEP_DETECTED_AT, WINDOW_US, ClockOffsetEstimator, ClockSync

YEARS_NS = 1_763_740_800_000_000_000  # Unix time of late 2025
BOOT_NS = -5_000_000_000
EPOCH = 77
Delay = Callable[[random.Random], float]


def jumping(rng: random.Random) -> float:
    return rng.uniform(0.0, 0.5)


def steady(_rng: random.Random) -> float:
    return 0.04


def mostly_quick(rng: random.Random) -> float:
    """Return the delays of a link with stalls."""
    return 0.002 + (rng.random() < 0.05) * rng.uniform(0.2, 0.5)


@dataclass
class Theirs:
    """True clock of the other side."""

    offset_ns: int
    ppm: float = 0.0

    def at(self, m_us: int) -> int:
        return self.offset_ns + m_us * 1000 + round(m_us * self.ppm / 1000)


def exchanged(
    clock: ClockOffsetEstimator,
    theirs: Theirs,
    *,
    out: Delay,
    back: Delay,
    reports: bool,
    until_s: int = 60,
    seed: int = 1,
) -> Iterator[int]:
    """Exchange a message every 0.1 s and a plan every 0.3 s, a tenth of both duplicated; yield the time of each event.

    Delays are drawn one by one, so that messages overtake each other; the report of a plan is in the next message.
    """
    rng = random.Random(seed)
    base_us = 3_600_000_000
    events: list[tuple[int, int, Callable[[], None]]] = []
    number, got = 0, [(-1, 0)]

    def at(m_us: float, act: Callable[[], None]) -> None:
        nonlocal number
        number += 1
        heapq.heappush(events, (round(m_us), number, act))

    def plan(m_us: int) -> None:
        for _ in range(1 + (rng.random() < 0.1)):
            arrives = round(m_us + 1e6 * out(rng))
            at(arrives, lambda arrives=arrives: got.append((m_us, theirs.at(arrives))))

    def message(m_us: int) -> None:
        stamp, (sent_us, received_ns) = theirs.at(m_us), got[-1]

        def come(arrived_us: int) -> None:
            clock.add_stamp(stamp, arrived_us)
            if reports and sent_us >= 0:
                clock.add_receipt(received_ns, sent_us)

        for _ in range(1 + (rng.random() < 0.1)):
            arrives = round(m_us + 1e6 * back(rng))
            at(arrives, lambda arrives=arrives: come(arrives))

    for k in range(until_s * 10):
        at(base_us + k * 100_000, lambda k=k: message(base_us + k * 100_000))
        if k % 3 == 0:
            at(base_us + k * 100_000 + 6_000, lambda k=k: plan(base_us + k * 100_000 + 6_000))
    while events:
        m_us, _, act = heapq.heappop(events)
        act()
        yield m_us


@pytest.mark.parametrize(("offset_ns", "ppm"), [(YEARS_NS, 50.0), (BOOT_NS, -50.0)])
@pytest.mark.parametrize(
    ("out", "back", "most_s"),
    # The bound is half the smallest delays of 30 s, of 300 messages one way and 100 the other, and drift's 3 ms.
    [
        (jumping, jumping, 0.025),
        (steady, steady, 0.0435),
        (mostly_quick, mostly_quick, 0.0055),
        (steady, jumping, 0.025),
    ],
)
def test_with_reports_the_true_time_is_within_half_the_smallest_round_trip(ppm, offset_ns, out, back, most_s):
    clock, theirs = ClockOffsetEstimator(), Theirs(offset_ns, ppm)
    two_way = []
    for m_us in exchanged(clock, theirs, out=out, back=back, reports=True):
        reading = clock.read(m_us)
        if reading is None or reading.mode is ClockMode.ONE_WAY:
            continue
        off_ns = m_us * 1000 + reading.offset_ns - theirs.at(m_us)
        assert abs(off_ns) <= reading.error_ns
        two_way.append(reading.error_ns)
    assert clock.clock_steps == 0
    assert len(two_way) > 500
    assert max(two_way[len(two_way) // 4 :]) <= most_s * 1e9


@pytest.mark.parametrize("ppm", [-50.0, 50.0])
@pytest.mark.parametrize("told_s", [0.0, 0.04])
@pytest.mark.parametrize("back", [jumping, steady])
def test_a_one_way_clock_is_behind_by_the_smallest_delay_and_states_no_error(ppm, told_s, back):
    clock, theirs = ClockOffsetEstimator(input_delay_ns=round(told_s * 1e9)), Theirs(YEARS_NS, ppm)
    behind = []
    for m_us in exchanged(clock, theirs, out=steady, back=back, reports=False):
        reading = clock.read(m_us)
        if reading is None:
            continue
        assert reading.mode is ClockMode.ONE_WAY
        assert reading.error_ns is None
        behind.append((theirs.at(m_us) - m_us * 1000 - reading.offset_ns) * 1e-9 + told_s)
    settled = behind[len(behind) // 4 :]
    if back is steady:
        assert min(settled) == pytest.approx(0.04, abs=0.0031)
        assert max(settled) == pytest.approx(0.04, abs=0.0031)
    else:
        assert min(settled) > -0.0001
        assert max(settled) < 0.025


def test_the_shortest_round_trip_counts_for_thirty_seconds_widened_by_drift():
    clock = ClockOffsetEstimator()
    clock.add_stamp(1_000_000, 1000)
    clock.add_receipt(2_000_000, 0)  # m = 0 -> theta <= 2 ms; m = 1 ms -> theta >= 0
    assert clock.read(1000) == (ClockMode.TWO_WAY, 1_000_050, 1_000_050)
    for second in range(1, 30):
        m_us = second * 1_000_000
        clock.add_stamp((m_us - 400_000) * 1000, m_us)
        clock.add_receipt((m_us + 400_000) * 1000, m_us)
    reading = clock.read(29_000_000)
    assert reading.error_ns == pytest.approx(1_000_000 + 29 * 100_000, abs=1000)
    m_us = WINDOW_US + 1_000
    clock.add_stamp((m_us - 400_000) * 1000, m_us)
    assert clock.read(m_us).error_ns > 150_000_000


def test_one_implausible_stamp_is_ignored_and_three_in_a_row_set_the_clock():
    clock = ClockOffsetEstimator()
    for k in range(50):
        assert clock.add_stamp(YEARS_NS + k * 100_000_000, k * 100_000)
    before = clock.read(5_000_000)
    hour_ns = 3_600_000_000_000
    assert not clock.add_stamp(YEARS_NS + hour_ns, 5_000_000)
    assert clock.add_stamp(YEARS_NS + 5_100_000_000, 5_100_000)
    assert not clock.add_stamp(YEARS_NS - hour_ns, 5_200_000)
    assert clock.read(5_200_000).offset_ns == pytest.approx(before.offset_ns, abs=100_000)
    assert clock.add_stamp(YEARS_NS + 5_300_000_000, 5_300_000)
    believed = [
        clock.add_stamp(YEARS_NS - hour_ns + k * 100_000_000, k * 100_000) for k in range(54, 54 + STEP_DETECTED_AT)
    ]
    assert believed == [False] * (STEP_DETECTED_AT - 1) + [True]
    assert clock.clock_steps == 1
    assert clock.read(5_700_000).offset_ns == pytest.approx(YEARS_NS - hour_ns, abs=100_000)


@pytest.mark.parametrize("off_s", [-0.5, 3600.0])
def test_implausible_receipt_times_are_ignored(off_s):
    clock = ClockOffsetEstimator()
    clock.add_stamp(YEARS_NS, 0)
    clock.add_receipt(YEARS_NS + round(off_s * 1e9), 0)
    assert clock.read(0).mode is ClockMode.ONE_WAY


# --- in a process ----------------------------------------------------------------------------------------------------


def estimate(t_ns: int) -> Estimate:
    return msgspec.structs.replace(Estimate.at_rest(), t_ns=t_ns)


def applied(t_ns: int, received_ns: int, sequence: int, epoch: int = EPOCH) -> Applied:
    return Applied(
        t_ns=t_ns,
        thrust_N=(0.0, 0.0, 0.0),
        command_N=(0.0, 0.0, 0.0),
        command_slew_N_per_s=(0.0, 0.0, 0.0),
        plan_epoch=epoch,
        plan_sequence=sequence,
        plan_cycle_t_ns=0,
        plan_received_t_ns=received_ns,
        plan_late=False,
        plans_late=0,
        plans_rejected=0,
    )


def begun() -> tuple[VehicleClock, ClockSync, int]:
    """Return an active synchronisation, by estimates delayed by 20 ms, and the time."""
    clock = VehicleClock()
    time = ClockSync(clock, epoch=EPOCH)
    for m_us in range(0, GRACE_US + 100_001, 100_000):
        assert clock.newest is None or m_us > GRACE_US
        assert time.check_stamp(estimate(YEARS_NS + (m_us - 20_000) * 1000), m_us) == ""
    return clock, time, m_us


def test_without_a_clock_for_half_a_second_the_time_is_that_of_the_stamps():
    clock, time, m_us = begun()
    assert time.active
    assert clock.read(m_us) == pytest.approx(YEARS_NS + (m_us - 20_000) * 1000, abs=100_000)
    assert time.offset(m_us)[0] is ClockMode.ONE_WAY


@pytest.mark.parametrize(
    ("epoch", "sequence", "mode"), [(EPOCH, 3, "two-way"), (EPOCH, 4, "one-way"), (5, 3, "one-way")]
)
def test_only_the_receipt_of_a_plan_that_this_process_sent_makes_it_two_way(epoch, sequence, mode):
    clock, time, m_us = begun()
    time.on_plan_sent(3, m_us)
    time.check_stamp(
        applied(YEARS_NS + (m_us + 30_000) * 1000, YEARS_NS + (m_us + 20_000) * 1000, sequence, epoch), m_us + 50_000
    )
    reading = time.offset(m_us + 50_000)
    assert reading.mode == mode
    if mode == "two-way":
        assert reading.offset_ns == pytest.approx(YEARS_NS, abs=200_000)
        assert reading.error_ns == pytest.approx(20_000_000, abs=200_000)
        assert clock.read(m_us + 50_000) == pytest.approx(YEARS_NS + (m_us + 50_000) * 1000, abs=200_000)


def test_a_reading_never_steps_back_unless_the_other_side_has_set_its_clock():
    clock, time, m_us = begun()
    before = clock.read(m_us)
    back_ns = YEARS_NS - 3_600_000_000_000
    said = [time.check_stamp(estimate(back_ns + k * 100_000_000), m_us + k * 100_000) for k in range(STEP_DETECTED_AT)]
    assert [bool(reason) for reason in said] == [True] * (STEP_DETECTED_AT - 1) + [False]
    m_us += (STEP_DETECTED_AT - 1) * 100_000
    assert before - clock.read(m_us) > 3_500_000_000_000
    assert time.clock_steps == 1


def test_stamps_are_not_compared_with_our_clock_where_a_clock_is_published():
    clock = VehicleClock()
    keeper = ClockSource(epoch=3, start_ns=0, speed=10.0, now_us=0)
    time = ClockSync(clock, epoch=EPOCH)
    assert time.check_stamp(estimate(0), 0) == ""
    clock.follow(keeper.run(0))
    for m_us in range(100_000, 5_000_000, 100_000):
        assert time.check_stamp(estimate(m_us * 10_000), m_us) == ""
    assert not time.active
    assert time.offset(m_us) == (ClockMode.SHARED, 0, 0)
    assert clock.read(m_us) == pytest.approx(m_us * 10_000, abs=600_000_000)
