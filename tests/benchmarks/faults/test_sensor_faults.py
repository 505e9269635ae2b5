"""A broken instrument says what its failure makes of the truth, numbered like anything else."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.faults.effects import Interval
from benchmarks.faults.sensor_faults import READINGS, Failure, FaultySensors, SensorFault
from ltv_mpc.messages import AdcpPing, CompassHeading, GnssFix, ImuSample, Message, PressureDepth, TdcpFix, Truth
from ltv_mpc.node import Inbox, OnMessage

MS, S = 1_000_000, 1_000_000_000
INTERVAL = Interval(S, 2 * S)
PERIOD_NS = 100 * MS


class Healthy:
    """Depth and heading ten times a second: the time in seconds, and its tenth."""

    name = "sensors"
    schedule = OnMessage((Truth,))
    reads: tuple[type[Message], ...] = (Truth,)
    writes: tuple[type[Message], ...] = (PressureDepth, CompassHeading)

    def step(self, t_ns: int, inbox: Inbox) -> list[Message]:  # noqa: ARG002
        return [PressureDepth(t_ns=t_ns, depth_m=1e-9 * t_ns), CompassHeading(t_ns=t_ns, heading_rad=1e-10 * t_ns)]


def said(failure: Failure, size: float = 1.0) -> list[tuple[int, PressureDepth]]:
    """Return the readings of the faulty pressure sensor with their times; the compass has no fault."""
    sensors = FaultySensors(Healthy(), [SensorFault(PressureDepth, failure, INTERVAL, size, seed=3)])
    result = []
    for t in range(0, 4 * S, PERIOD_NS):
        signals = sensors.step(t, [])
        assert [x.heading_rad for x in signals if isinstance(x, CompassHeading)] == [1e-10 * t]
        result += [(t, x) for x in signals if isinstance(x, PressureDepth)]
    return result


def during(messages: list[tuple[int, PressureDepth]]) -> list[PressureDepth]:
    return [x for t, x in messages if INTERVAL.contains(t)]


@pytest.mark.parametrize("failure", Failure)
def test_before_and_after_it_is_well(failure):
    well = [(t, x.depth_m) for t, x in said(failure, 0.3) if t < S or (t >= 2 * S + 300 * MS)]
    assert well == [(t, 1e-9 * t) for t in [*range(0, S, PERIOD_NS), *range(2 * S + 300 * MS, 4 * S, PERIOD_NS)]]


def test_off_says_nothing():
    assert during(said(Failure.OFF)) == []


def test_stuck_repeats_its_last_value_with_the_stamps_of_now():
    stuck = during(said(Failure.STUCK))
    assert [x.depth_m for x in stuck] == [0.9] * 10
    assert [x.t_ns for x in stuck] == list(range(S, 2 * S, PERIOD_NS))


def test_garbage_is_anything_within_its_range():
    values = np.array([x.depth_m for x in during(said(Failure.GARBAGE, 0.5))])
    assert np.ptp(values) > 20.0
    assert np.abs(values).max() <= 50.0


def test_wrong_is_biased_by_its_size():
    bias = [x.depth_m - 1e-9 * x.t_ns for x in during(said(Failure.WRONG, 2.0))]
    assert bias == pytest.approx([6.0] * 10)


def test_slow_says_one_of_several():
    assert [x.t_ns for x in during(said(Failure.SLOW, 4.0))] == [S + 300 * MS, S + 700 * MS]


def test_delayed_says_everything_late_and_stamped_right():
    late = [(t, x) for t, x in said(Failure.DELAYED, 0.25) if INTERVAL.contains(x.t_ns)]
    assert [x.t_ns for _, x in late] == list(range(S, 2 * S, PERIOD_NS))
    assert {t - x.t_ns for t, x in late} == {300 * MS}  # at the next step of the sensors


def test_intermittent_comes_and_goes():
    times = [x.t_ns for x in during(said(Failure.INTERMITTENT, 0.2))]
    assert 0 < len(times) < 10


def test_every_instrument_that_may_break_has_readings_of_its_message():
    assert set(READINGS) == {ImuSample, AdcpPing, CompassHeading, PressureDepth, GnssFix, TdcpFix}
    for kind, readings in READINGS.items():
        assert all(reading.field in kind.__struct_fields__ for reading in readings)
