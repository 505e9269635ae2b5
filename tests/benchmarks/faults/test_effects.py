"""Injected faults: what each does to messages, sensors, solver and controller, in its interval alone."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.faults.effects import (
    Interval,
)
from benchmarks.faults.message_faults import (
    Delivery,
    MessageFault,
    MessageFaultInterval,
    MessageFaults,
)
from benchmarks.faults.sensor_faults import Failure, FaultySensors, SensorFault
from ltv_mpc.messages import (
    CompassHeading,
    ImuSamples,
    Message,
    PressureDepth,
)
from ltv_mpc.node import Grid, Inbox, ReceivedMessage
from ltv_mpc.validation import rejection_reason

MS, S = 1_000_000, 1_000_000_000
INTERVAL = Interval(S, 2 * S)
PERIOD_NS = 100 * MS


def depth(t_ns: int) -> PressureDepth:
    return PressureDepth(t_ns=t_ns, depth_m=1e-9 * t_ns)


# --- messages: ten a second, numbered; those of 10 to 19 are in the interval -----------------------------------------


def message_faults(harm: MessageFault, size: float = 1.0, kind: type[Message] = PressureDepth) -> MessageFaults:
    def accept(_: str, delivery: Delivery) -> ReceivedMessage | str:
        return rejection_reason(delivery.message.message) or delivery.message

    fault = MessageFaultInterval((kind,), harm, INTERVAL, size, seed=4)
    return MessageFaults([fault], encode=lambda _: bytes(range(60)), receive=accept)


def through(way: MessageFaults) -> list[Delivery]:
    sent = [ReceivedMessage(depth(i * PERIOD_NS), 1, i, i * PERIOD_NS) for i in range(30)]
    return [delivery for message in sent for delivery in way.carry("sensors", "estimator", message)]


def seen(deliveries: list[Delivery]) -> list[tuple[int, int, int]]:
    """Return arrival (ms), number and stamp (ms)."""
    return [(d.at_ns // MS, d.message.sequence, d.message.message.t_ns // MS) for d in deliveries]


def well(numbers: range) -> list[tuple[int, int, int]]:
    return [(100 * i, i, 100 * i) for i in numbers]


@pytest.mark.parametrize(
    ("harm", "size", "during"),
    [
        (MessageFault.LOSS, 1.0, []),
        (MessageFault.DELAY, 0.25, [(100 * i + 250, i, 100 * i) for i in range(10, 20)]),
        (MessageFault.REORDER, 1.0, [(100 * (i | 1), i, 100 * i) for k in range(10, 20, 2) for i in (k + 1, k)]),
        (MessageFault.DUPLICATE, 1.0, [(100 * i + late, i, 100 * i) for i in range(10, 20) for late in (0, 40)]),
        (MessageFault.STALE, 1.0, [(100 * i, i, 1000) for i in range(10, 20)]),
        (MessageFault.CLOCK_JUMP, -3600.0, [(100 * i, i, 100 * i - 3_600_000) for i in range(10, 20)]),
    ],
)
def test_a_message_fault_harms_those_of_its_interval_and_type(
    harm: MessageFault, size: float, during: list[tuple[int, int, int]]
) -> None:
    way = message_faults(harm, size)
    assert seen(through(way)) == [*well(range(10)), *during, *well(range(20, 30))]
    assert way.harmed == [{MessageFault.REORDER: 5, MessageFault.STALE: 9}.get(harm, 10)]
    assert seen(through(message_faults(harm, size, kind=ImuSamples))) == well(range(30))


class Speaker:
    name = "sensors"
    schedule = Grid(PERIOD_NS)
    reads: tuple[type[Message], ...] = ()
    writes: tuple[type[Message], ...] = (PressureDepth, CompassHeading)

    def step(self, t_ns: int, inbox: Inbox) -> list[Message]:  # noqa: ARG002
        return [depth(t_ns), CompassHeading(t_ns=t_ns, heading_rad=1e-10 * t_ns)]


# --- sensors: a pressure sensor that fails beside a sound compass ----------------------------------------------------


@pytest.mark.parametrize(
    ("failure", "size", "during"),
    [
        (Failure.OFF, 1.0, []),
        (Failure.STUCK, 1.0, [(100 * i, 100 * i, 0.9) for i in range(10, 20)]),
        (Failure.WRONG, 2.0, [(100 * i, 100 * i, 0.1 * i + 6.0) for i in range(10, 20)]),
        (Failure.SLOW, 4.0, [(1300, 1300, 1.3), (1700, 1700, 1.7)]),
        (Failure.DELAYED, 0.3, [(100 * i + 300, 100 * i, 0.1 * i) for i in range(10, 20)]),
    ],
)
def test_a_failing_sensor_fails_in_its_interval_alone(
    failure: Failure, size: float, during: list[tuple[int, int, float]]
) -> None:
    outside = [(100 * i, 100 * i, 0.1 * i) for i in (*range(10), *range(20, 30))]
    np.testing.assert_allclose(sorted(said(failure, size)), sorted([*outside, *during]), atol=1e-9)


def said(failure: Failure, size: float) -> list[tuple[int, int, float]]:
    """Return time and stamp (ms) and value of the faulty sensor's readings."""
    sensors = FaultySensors(Speaker(), [SensorFault(PressureDepth, failure, INTERVAL, size, seed=3)])
    result = []
    for t_ns in range(0, 3 * S, PERIOD_NS):
        signals = sensors.step(t_ns, [])
        assert [x.heading_rad for x in signals if isinstance(x, CompassHeading)] == [1e-10 * t_ns]
        result += [(t_ns // MS, x.t_ns // MS, x.depth_m) for x in signals if isinstance(x, PressureDepth)]
    return result
