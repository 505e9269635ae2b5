"""Times of recorded messages: by the announced clock, by the vehicle's own, or by the host's."""

from __future__ import annotations

import time

import msgspec
import pytest

from ltv_mpc.messages import Estimate
from services.runtime.clock import monotonic_us
from services.runtime.recording_loop import FOLLOWS_HOST, FOLLOWS_VEHICLE, PublicationTime
from tests.services.words import running_clock

S_US, S_NS = 1_000_000, 1_000_000_000
BEGAN_NS = 1_790_000_000 * S_NS
"""Time of the vehicle's clock at monotonic time 0: it counts from 1970."""
LATENCY_US = 3_000
ESTIMATE = Estimate.at_rest(depth_m=None, heading_rad=0.0)


@pytest.fixture
def said() -> list[str]:
    return []


@pytest.fixture
def times(said: list[str]) -> PublicationTime:
    return PublicationTime(start_ns=None, say=said.append)


def stamp(times: PublicationTime, sent_us: int, *, set_by_ns: int = 0) -> None:
    """Receive an estimate that was stamped at ``sent_us`` of our monotonic time."""
    estimate = msgspec.structs.replace(ESTIMATE, t_ns=BEGAN_NS + sent_us * 1000 + set_by_ns)
    times.add(estimate, 7, sent_us + LATENCY_US)


def begin(times: PublicationTime, *, first_us: int = 100 * S_US) -> int:
    """Receive the stamps of one second; return the monotonic time after it."""
    for k in range(11):
        stamp(times, first_us + k * S_US // 10)
    return first_us + S_US


def test_without_a_clock_the_stamps_of_the_vehicle_date_all_messages(times: PublicationTime, said: list[str]) -> None:
    stamp(times, 99 * S_US)
    assert not times.known
    assert times.at(99 * S_US, 99 * S_US) is None
    now_us = begin(times)
    assert said == [FOLLOWS_VEHICLE]
    for instant_us in (now_us, now_us - 5 * S_US, 0):  # also of messages that arrived before the first stamp
        t_ns = times.at(instant_us, instant_us)
        assert t_ns == pytest.approx(BEGAN_NS + instant_us * 1000, abs=LATENCY_US * 1000 + 100_000)


def test_the_monotonic_clock_of_another_host_does_not_date_a_message(times: PublicationTime) -> None:
    now_us = begin(times)
    arrived_ns = times.at(now_us, now_us)
    for of_another_host_us in (now_us - 60 * S_US, now_us - 2 * S_US, now_us + 60 * S_US):
        assert times.at(of_another_host_us, now_us) == arrived_ns


def test_a_vehicle_clock_that_is_set_leaves_the_time_axis_without_a_step(times: PublicationTime) -> None:
    now_us = begin(times)
    for k in range(1, 60):
        stamp(times, now_us + k * S_US // 10, set_by_ns=60 * S_NS)
    later_us = now_us + 6 * S_US
    before_ns, after_ns = times.at(now_us, now_us), times.at(later_us, later_us)
    assert before_ns is not None
    assert after_ns == pytest.approx(before_ns + 6 * S_NS, abs=50_000_000)


def test_an_announced_clock_is_followed_and_stamps_are_not(times: PublicationTime, said: list[str]) -> None:
    times.add(running_clock(100 * S_US, vehicle_ns=5), 3, 100 * S_US)
    now_us = begin(times)
    assert said == []
    assert times.at(now_us, now_us) == 5 + S_NS


def test_a_clock_that_comes_after_the_stamps_does_not_change_the_axis(times: PublicationTime, said: list[str]) -> None:
    now_us = begin(times)
    times.add(running_clock(now_us, vehicle_ns=5), 3, now_us)
    assert times.at(now_us, now_us) == pytest.approx(BEGAN_NS + now_us * 1000, abs=5_000_000)
    assert said == [FOLLOWS_VEHICLE]


def test_without_any_time_the_host_s_clock_is_taken_and_kept(times: PublicationTime, said: list[str]) -> None:
    now_us = monotonic_us()
    times.follow_host()
    before_us = now_us - 2 * S_US
    assert times.at(before_us, before_us) == pytest.approx(time.time_ns() - 2 * S_NS, abs=S_NS)
    begin(times, first_us=now_us)
    assert times.at(now_us, now_us) == pytest.approx(time.time_ns(), abs=S_NS)
    assert said == [FOLLOWS_HOST]


def test_in_a_simulation_messages_before_the_clock_have_the_time_of_its_start(said: list[str]) -> None:
    times = PublicationTime(start_ns=-S_NS, say=said.append)
    assert times.known
    assert times.at(5, 5) == -S_NS
    times.add(running_clock(100 * S_US, vehicle_ns=5), 3, 100 * S_US)
    assert times.at(101 * S_US, 102 * S_US) == 5 + S_NS  # when it was sent, not when it arrived
