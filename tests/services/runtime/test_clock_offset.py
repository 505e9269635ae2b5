"""Offset of a publisher's clock: the error bound holds for any delays, and steps of the clock are recognised."""

from __future__ import annotations

import random
from bisect import bisect
from collections.abc import Callable, Iterator

import pytest

from ltv_mpc.messages import ClockMode
from services.runtime.clock_offset import WINDOW_US, ClockOffsetEstimator

YEARS_NS = 1_763_740_800_000_000_000  # Unix time of late 2025
BOOT_NS = -5_000_000_000
Delay = Callable[[random.Random], float]


def jumping(rng: random.Random) -> float:
    return rng.uniform(0.0, 0.5)


def steady(_rng: random.Random) -> float:
    return 0.04


def mostly_quick(rng: random.Random) -> float:
    """Return the delays of a link with stalls."""
    return 0.002 + (rng.random() < 0.05) * rng.uniform(0.2, 0.5)


def drifting(offset_ns: int, ppm: float) -> Callable[[int], int]:
    """Return the true clock of the other side: its time (ns) at our time (us)."""
    return lambda m_us: offset_ns + m_us * 1000 + round(m_us * ppm / 1000)


def exchanged(
    clock: ClockOffsetEstimator, theirs: Callable[[int], int], *, out: Delay, back: Delay, reports: bool, seed: int = 1
) -> Iterator[int]:
    """Exchange messages for a minute, one every 0.1 s and a plan every 0.3 s, a tenth of both duplicated.

    Yield the arrival of each message; ``theirs`` is the true clock of the other side. Delays are drawn one by one, so
    that messages overtake each other; the report of a plan is in the next message.
    """
    rng = random.Random(seed)

    def arrivals(begin_us: int, period_us: int, delay: Delay) -> list[tuple[int, int]]:
        sent = range(begin_us, begin_us + 60_000_000, period_us)
        twice = [m_us for m_us in sent for _ in range(1 + (rng.random() < 0.1))]
        return sorted((m_us + round(1e6 * delay(rng)), m_us) for m_us in twice)

    hour_us = 3_600_000_000
    plans = arrivals(hour_us + 6_000, 300_000, out)
    for arrived_us, m_us in arrivals(hour_us, 100_000, back):
        clock.add_stamp(theirs(m_us), arrived_us)
        if reports and (received := bisect(plans, (m_us, m_us))):
            plan_arrived_us, sent_us = plans[received - 1]
            clock.add_receipt(theirs(plan_arrived_us), sent_us)
        yield arrived_us


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
    clock, theirs = ClockOffsetEstimator(), drifting(offset_ns, ppm)
    two_way = []
    for m_us in exchanged(clock, theirs, out=out, back=back, reports=True):
        reading = clock.read(m_us)
        if reading.mode is ClockMode.ONE_WAY:
            continue
        off_ns = m_us * 1000 + reading.offset_ns - theirs(m_us)
        assert abs(off_ns) <= reading.error_ns
        two_way.append(reading.error_ns)
    assert clock.clock_steps == 0
    assert len(two_way) > 500
    assert max(two_way[len(two_way) // 4 :]) <= most_s * 1e9


@pytest.mark.parametrize("ppm", [-50.0, 50.0])
@pytest.mark.parametrize("told_s", [0.0, 0.04])
@pytest.mark.parametrize(("back", "least_s", "most_s"), [(jumping, -0.0001, 0.025), (steady, 0.0369, 0.0431)])
def test_a_one_way_clock_is_behind_by_the_smallest_delay_and_states_no_error(ppm, told_s, back, least_s, most_s):
    clock, theirs = ClockOffsetEstimator(input_delay_ns=round(told_s * 1e9)), drifting(YEARS_NS, ppm)
    behind = []
    for m_us in exchanged(clock, theirs, out=steady, back=back, reports=False):
        reading = clock.read(m_us)
        assert reading.mode is ClockMode.ONE_WAY
        assert reading.error_ns is None
        behind.append((theirs(m_us) - m_us * 1000 - reading.offset_ns) * 1e-9 + told_s)
    assert clock.clock_steps == 0
    settled = behind[len(behind) // 4 :]
    assert least_s <= min(settled) <= max(settled) <= most_s


def test_the_shortest_round_trip_counts_for_thirty_seconds_widened_by_drift():
    clock = ClockOffsetEstimator()
    clock.add_stamp(1_000_000, 1000)
    clock.add_receipt(2_000_000, 0)  # m = 0 -> theta <= 2 ms; m = 1 ms -> theta >= 0
    assert clock.read(1000) == (ClockMode.TWO_WAY, 1_000_050, 1_000_050)
    for second in range(1, 30):
        m_us = second * 1_000_000
        clock.add_stamp((m_us - 400_000) * 1000, m_us)
        clock.add_receipt((m_us - 600_000) * 1000, m_us - 1_000_000)  # of the plan of a second ago
    reading = clock.read(29_000_000)
    assert reading.error_ns == pytest.approx(1_000_000 + 29 * 100_000, abs=1000)
    m_us = WINDOW_US + 1_000
    clock.add_stamp((m_us - 400_000) * 1000, m_us)
    assert clock.read(m_us).error_ns > 150_000_000


@pytest.mark.parametrize("off_s", [-0.5, 3600.0])
def test_implausible_receipt_times_are_ignored(off_s):
    clock = ClockOffsetEstimator()
    clock.add_stamp(YEARS_NS, 0)
    clock.add_receipt(YEARS_NS + round(off_s * 1e9), 0)
    assert clock.read(0).mode is ClockMode.ONE_WAY


# --- steps of the clock: test_clock_sync.py has their sizes and their recognition -------------------------------------

DAY_S = 86_400.0


@pytest.mark.parametrize("two_way", [True, False])
@pytest.mark.parametrize("ahead_s", [0.2, 5.0, DAY_S])
def test_one_stamp_ahead_changes_nothing(two_way, ahead_s):
    clock = ClockOffsetEstimator()
    for m_us in range(0, 20_000_000, 100_000):
        assert clock.add_stamp(YEARS_NS + m_us * 1000, m_us)
        if two_way:
            clock.add_receipt(YEARS_NS + (m_us + 1000) * 1000, m_us)
    before = clock.read(20_000_000)
    assert not clock.add_stamp(YEARS_NS + 20_000_000_000 + round(ahead_s * 1e9), 20_000_000)
    assert clock.add_stamp(YEARS_NS + 20_100_000_000, 20_100_000)
    assert clock.read(20_100_000).offset_ns == pytest.approx(before.offset_ns, abs=100_000)
    assert clock.clock_steps == 0


def test_stamps_ahead_that_do_not_agree_are_no_step():
    clock = ClockOffsetEstimator()
    rng = random.Random(2)
    for m_us in range(0, 10_000_000, 100_000):
        clock.add_stamp(m_us * 1000, m_us)
    for m_us in range(10_000_000, 20_000_000, 100_000):
        assert not clock.add_stamp(m_us * 1000 + rng.randrange(10**9, 10**15), m_us)
    assert clock.clock_steps == 0


def late_by(delay_us: Callable[[int], int], until_us: int = 30_000_000) -> ClockOffsetEstimator:
    """Return the estimator after a stamp each 0.1 s that arrives with a delay."""
    clock = ClockOffsetEstimator()
    for m_us in range(0, until_us, 100_000):
        clock.add_stamp(m_us * 1000, m_us + delay_us(m_us))
    return clock


def test_contradictions_that_are_not_in_a_row_are_no_step():
    clock = ClockOffsetEstimator()
    wrong_ns = 5_000_000_000
    for k, m_us in enumerate(range(0, 20_000_000, 100_000)):
        ahead = k >= 50 and k % 3 != 0
        assert clock.add_stamp(m_us * 1000 + wrong_ns * ahead, m_us) != ahead
        if not ahead:
            early = k >= 50 and k % 2 == 0
            assert clock.add_receipt((m_us + 1000) * 1000 - wrong_ns * early, m_us) != early
    assert clock.clock_steps == 0


def test_lateness_that_varies_is_no_step():
    rng = random.Random(3)
    clock = late_by(lambda m_us: 2_000 if m_us < 10_000_000 else round(1e6 * rng.uniform(0.3, 1.5)))
    assert clock.clock_steps == 0


def test_a_slow_first_message_costs_no_other():
    clock = late_by(lambda m_us: 0 if m_us else 300_000, until_us=2_000_000)
    assert (clock.clock_steps, clock.stamps) == (0, 20)


def test_a_step_back_is_seen_by_lateness_where_no_plan_arrives_any_more():
    """The last receipt, from before the step, is repeated. It is later than the stamps of its messages."""
    clock = ClockOffsetEstimator()
    for m_us in range(0, 12_000_000, 100_000):
        clock.add_stamp((m_us - 5_000_000 * (m_us >= 10_000_000)) * 1000, m_us)
        sent_us = min(m_us, 9_900_000)
        clock.add_receipt((sent_us + 1000) * 1000, sent_us)
    assert clock.clock_steps == 1
    assert not clock.certain


def test_a_link_that_is_slow_one_way_is_no_step_where_receipts_show_it():
    clock = ClockOffsetEstimator()
    for m_us in range(0, 40_000_000, 100_000):
        arrives = m_us + (2_000 if m_us < 20_000_000 else 1_500_000)
        clock.add_stamp(m_us * 1000, arrives)
        clock.add_receipt((m_us - 100_000 + 2_000) * 1000, m_us - 100_000)
    assert clock.clock_steps == 0


def test_where_a_congested_link_clears_up_the_clock_is_set_forward_again():
    clock = late_by(lambda m_us: 800_000 if 10_000_000 <= m_us < 20_000_000 else 2_000)
    assert clock.clock_steps == 2
    assert clock.certain
    assert clock.read(30_000_000).offset_ns == pytest.approx(-2_000_000, abs=1_100_000)
