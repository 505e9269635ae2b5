"""Injected faults: what each does to messages, sensors, solver and controller, in its interval alone."""

from __future__ import annotations

import math

import numpy as np
import pytest

from benchmarks.faults.effects import (
    FaultySolver,
    InjectedSolverError,
    Interval,
    SolverClock,
    SolverFault,
    SolverFaultInterval,
)
from benchmarks.faults.message_faults import (
    Delivery,
    MessageFault,
    MessageFaultInterval,
    MessageFaults,
)
from benchmarks.faults.sensor_faults import READINGS, Failure, FaultySensors, SensorFault
from ltv_mpc.control.ocp.problem import Problem
from ltv_mpc.control.solvers.interface import Result
from ltv_mpc.messages import (
    CompassHeading,
    Estimate,
    ImuSample,
    ImuSamples,
    Message,
    PressureDepth,
    Solve,
    SolveStatus,
)
from ltv_mpc.node import Grid, Inbox, ReceivedMessage
from ltv_mpc.validation import rejection_reason
from tests.stepping import as_sent

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


def test_a_share_of_the_messages_is_lost() -> None:
    way = message_faults(MessageFault.LOSS, 0.5)
    came = through(way)
    assert 0 < way.harmed[0] < 10
    assert len(came) == 30 - way.harmed[0]


def test_damage_flips_a_few_bits_of_the_bytes() -> None:
    for delivery in through(message_faults(MessageFault.CORRUPTION))[10:20]:
        flipped = sum((a ^ b).bit_count() for a, b in zip(delivery.payload, range(60), strict=True))
        assert 1 <= flipped <= 8


@pytest.mark.parametrize(
    "signal",
    [
        depth(S),
        Estimate.at_rest(depth_m=3.0),
        as_sent(
            ImuSample(t_ns=S, interval_ns=5, angular_rate_radps=(0.1, 0.2, 0.3), specific_force_mps2=(0.0, 0.0, -9.8))
        ),
    ],
)
def test_what_is_no_number_is_refused_for_it_in_whatever_field(signal: Message) -> None:
    way, reasons = message_faults(MessageFault.NOT_A_NUMBER, kind=type(signal)), set()
    for sequence in range(60):
        (came,) = way.carry("a", "b", ReceivedMessage(signal, 1, sequence, S))
        reason = rejection_reason(came.message.message)
        assert "must be from" in reason
        reasons |= {word for word in map(str, (math.nan, math.inf, -math.inf)) if word in reason}
    assert reasons == {"nan", "inf", "-inf"}
    assert rejection_reason(signal) is None


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


def test_garbage_is_anything_within_its_range_and_an_intermittent_sensor_comes_and_goes() -> None:
    values = np.array([x for t, _, x in said(Failure.GARBAGE, 0.5) if 1000 <= t < 2000])
    assert np.ptp(values) > 20.0
    assert np.abs(values).max() <= 50.0
    assert 0 < sum(1000 <= t < 2000 for t, *_ in said(Failure.INTERMITTENT, 0.2)) < 10
    for kind, readings in READINGS.items():
        assert all(reading.field in kind.__struct_fields__ for reading in readings)


# --- solver and controller -------------------------------------------------------------------------------------------


class Good:
    def solve(self, problem: Problem, shift: float, *, last: bool = True) -> Result:  # noqa: ARG002
        return GOOD


PROBLEM = Problem.empty(1, 1, 1, 0)
GOOD = Result(np.ones((3, 2)), Solve(status=SolveStatus.SOLVED))


@pytest.mark.parametrize(
    ("fault", "status"), [(SolverFault.FAILS, SolveStatus.FAILED), (SolverFault.LIES, SolveStatus.SOLVED)]
)
def test_a_faulty_solver_gives_no_finite_command_in_its_interval(fault: SolverFault, status: SolveStatus) -> None:
    now = SolverClock()
    solver = FaultySolver(Good(), [SolverFaultInterval(fault, INTERVAL)], now)
    for now.t_ns in (S - 1, 2 * S):
        assert solver.solve(PROBLEM, 0.0) is GOOD
    now.t_ns = S
    z, solve = solver.solve(PROBLEM, 0.0)
    assert np.isnan(z).all()
    assert solve.status is status
    with pytest.raises(InjectedSolverError):
        FaultySolver(Good(), [SolverFaultInterval(SolverFault.RAISES, INTERVAL)], now).solve(PROBLEM, 0.0)
