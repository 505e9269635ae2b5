"""Sensor faults with the failure modes of PX4: off, stuck, garbage, wrong, slow, delayed, intermittent.

Faulty sensors are a node around the sensors' node. A message that is suppressed gets no sequence number; a wrong one
is numbered and stamped like any other. Neither the node inside nor the readers know of the fault.
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import msgspec
import numpy as np

from benchmarks.faults.effects import Interval, NodeWrapper
from ltv_mpc.messages import AdcpPing, CompassHeading, GnssFix, ImuSample, ImuSamples, Message, PressureDepth, TdcpFix
from ltv_mpc.node import Inbox, Node


class Reading(NamedTuple):
    """Measured field of a message, in SI units."""

    field: str
    bias: float  # of a faulty sensor of this kind
    garbage: float  # random values lie within +- this


READINGS: Mapping[type[Message], tuple[Reading, ...]] = {
    ImuSample: (Reading("angular_rate_radps", 0.02, 2.0), Reading("specific_force_mps2", 0.1, 20.0)),
    AdcpPing: (Reading("beam_velocity_mps", 0.2, 3.0),),
    CompassHeading: (Reading("heading_rad", 0.5, 3.0),),
    PressureDepth: (Reading("depth_m", 3.0, 100.0),),
    GnssFix: (Reading("north_m", 20.0, 1000.0), Reading("east_m", 20.0, 1000.0)),
    TdcpFix: (Reading("north_m", 0.5, 50.0), Reading("east_m", 0.5, 50.0)),
}
"""Readings by type. The biases are a few to a hundred times those of a good sensor of the shipped files."""

TIMES = ("t_ns", "from_t_ns", "interval_ns")


def changed(signal: Message, change: Callable[[Reading, Any], Any]) -> Message:
    """Return the message with each measured value replaced by ``change(reading, value)``, of equal shape and type."""
    values: dict[str, Any] = {}
    for reading in READINGS[type(signal)]:
        old = getattr(signal, reading.field)
        new = change(reading, np.asarray(old, dtype=np.float64))
        values[reading.field] = tuple(new.tolist()) if isinstance(old, tuple) else new if np.ndim(old) else float(new)
    return msgspec.structs.replace(signal, **values)


def restamped(old: Message, now: Message) -> Message:
    """Return the reading of ``old`` with the stamps of ``now``."""
    times = {name: getattr(now, name) for name in TIMES if name in now.__struct_fields__}
    return msgspec.structs.replace(old, **times)


class Failure(enum.StrEnum):
    """Failure modes of PX4's failure injection."""

    OFF = "off"  # no messages
    STUCK = "stuck"  # the last reading, with current stamps
    GARBAGE = "garbage"  # random values
    WRONG = "wrong"  # biased
    SLOW = "slow"  # one message of several
    DELAYED = "delayed"  # arrives late, with the right stamp
    INTERMITTENT = "intermittent"  # comes and goes


class SensorFault(NamedTuple):
    """One failure of one sensor.

    The unit of ``size`` depends on the failure. Garbage and wrong: multiple of the range or bias in ``READINGS``. Slow:
    number of messages of which one is published. Delayed: seconds. Intermittent: mean length (s) of a silence, and of
    the time between two. Off and stuck have no size.
    """

    kind: type[Message]
    failure: Failure
    interval: Interval
    size: float
    seed: int


class FaultySensors(NodeWrapper):
    """Node around the sensors' node that applies sensor faults to its messages."""

    def __init__(self, sensors: Node, faults: Sequence[SensorFault]) -> None:
        super().__init__(sensors)
        self._faulty = [_FaultySensor(fault) for fault in faults]

    def step(self, t_ns: int, inbox: Inbox) -> Sequence[Message]:
        """Step the sensors and apply the faults to their messages, each inertial sample being one."""
        outputs: list[Message] = []
        for message in self._node.step(t_ns, inbox):
            outputs += message.samples if isinstance(message, ImuSamples) else (message,)
        for sensor in self._faulty:
            outputs = sensor.apply(t_ns, outputs)
        samples = tuple(message for message in outputs if isinstance(message, ImuSample))
        others = [message for message in outputs if not isinstance(message, ImuSample)]
        return [*others, ImuSamples(samples=samples)] if samples else others


class _FaultySensor:
    """One fault and its state."""

    def __init__(self, fault: SensorFault) -> None:
        self._fault = fault
        self._kind = ImuSample if fault.kind is ImuSamples else fault.kind
        self._rng = np.random.default_rng(fault.seed)
        self._count = 0
        self._last: Message | None = None
        self._late: list[tuple[int, Message]] = []
        self._silent = True
        self._until_ns = fault.interval.start_ns

    def apply(self, t_ns: int, messages: Sequence[Message]) -> list[Message]:
        """Return the messages of one step: those of its sensor changed, delayed or dropped, the others unchanged."""
        here = [signal for due_ns, signal in self._late if due_ns <= t_ns]
        self._late = [(due_ns, signal) for due_ns, signal in self._late if due_ns > t_ns]
        for signal in messages:
            if type(signal) is not self._kind:
                here.append(signal)
            elif self._fault.interval.contains(t_ns):
                here += self._failed(t_ns, signal)
            else:
                self._last = signal
                here.append(signal)
        return here

    def _failed(self, t_ns: int, signal: Message) -> list[Message]:
        """Return what the failing sensor publishes in place of one message."""
        size, rng = self._fault.size, self._rng
        self._count += 1
        match self._fault.failure:
            case Failure.OFF:
                return []
            case Failure.STUCK:
                self._last = self._last or signal
                return [restamped(self._last, signal)]
            case Failure.GARBAGE:
                return [changed(signal, lambda r, x: size * r.garbage * rng.uniform(-1.0, 1.0, x.shape))]
            case Failure.WRONG:
                return [changed(signal, self._biased)]
            case Failure.SLOW:
                return [signal] if self._count % max(2, round(size)) == 0 else []
            case Failure.DELAYED:
                self._late.append((t_ns + round(size * 1e9), signal))
                return []
            case Failure.INTERMITTENT:
                while t_ns >= self._until_ns:
                    self._silent = not self._silent if self._until_ns > self._fault.interval.start_ns else True
                    self._until_ns += 1 + round(rng.exponential(size) * 1e9)
                return [] if self._silent else [signal]

    def _biased(self, reading: Reading, value: Any) -> Any:
        return value + self._fault.size * reading.bias
