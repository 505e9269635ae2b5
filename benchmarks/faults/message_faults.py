"""Message faults: loss, delay, reordering, duplication, corruption, non-finite values, stale data and wrong stamps.

``MessageFaults`` is a transport between the nodes of a lock step (``sim.scheduler.Transport``). A message passes
through the first active fault that concerns its type; all others arrive as published. Harmed messages are counted,
so that the readers' own counts can be compared with them.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import msgspec
import numpy as np

from benchmarks.faults.effects import Interval
from ltv_mpc.messages import ImuSample, ImuSamples, Message
from ltv_mpc.node import ReceivedMessage
from ltv_mpc.validation import bounds
from sim.scheduler import Delivery


class MessageFault(enum.StrEnum):
    """Kind of fault of a message on its way."""

    LOSS = "loss"
    DELAY = "delay"
    REORDER = "reorder"  # delivered after its successor
    DUPLICATE = "duplicate"
    CORRUPTION = "corruption"  # a few bits of the frame are flipped
    NOT_A_NUMBER = "not_a_number"  # one of its numbers becomes NaN or infinity
    STALE = "stale"  # the sender repeats an old message
    CLOCK_JUMP = "clock_jump"  # its stamps come from a clock that has jumped


class MessageFaultInterval(NamedTuple):
    """Message fault, the types that it concerns and the interval in which it is active.

    The unit of ``size`` depends on the fault. Loss, reorder, duplicate, corruption and not a number: share of the
    messages that are harmed. Delay: seconds. Clock jump: seconds by which stamps are ahead. Stale has no size.
    """

    kinds: tuple[type[Message], ...]
    harm: MessageFault
    interval: Interval
    size: float
    seed: int


Encode = Callable[[ReceivedMessage], bytes]
"""Function that returns a message's frame; the wire format is defined elsewhere."""

Admit = Callable[[str, Delivery], ReceivedMessage | str]
"""Function of reader and delivery that returns the accepted message, or the reason for its rejection."""

AGAIN_NS = 40_000_000
"""Delay of the second copy of a duplicated message."""

MAX_FLIPPED_BITS = 8
"""Largest number of bits that corruption inverts in one frame."""

NOT_NUMBERS = (math.nan, math.inf, -math.inf)


class MessageFaults:
    """Transport of one run that applies message faults."""

    def __init__(self, faults: Sequence[MessageFaultInterval], *, encode: Encode, receive: Admit) -> None:
        self._faults: list[_Fault] = []
        self._kinds: set[type[Message]] = set()
        self._encode = encode
        self._receive = receive
        for fault in faults:
            self.add(fault)

    def add(self, fault: MessageFaultInterval) -> None:
        """Add a fault."""
        self._faults.append(_FAULTS[fault.harm](fault, self._encode))
        self._kinds.update(fault.kinds)

    @property
    def harmed(self) -> list[int]:
        """Number of messages that each fault has harmed, in the order of the faults."""
        return [harm.harmed for harm in self._faults]

    def covers(self, kind: type[Message]) -> bool:
        """Return True if any fault concerns messages of this type, active or not."""
        return kind in self._kinds

    def carry(self, writer: str, reader: str, message: ReceivedMessage) -> Sequence[Delivery]:  # noqa: ARG002  (a type is a key)
        """Return the deliveries of a message; the first active fault that concerns its type decides."""
        if type(message.message) in self._kinds:
            for harm in self._faults:
                if harm.concerns(message):
                    return harm.deliveries(message)
        return [Delivery(message.received_t_ns, message)]

    def receive(self, reader: str, delivery: Delivery) -> ReceivedMessage | str:
        """Return the message if the reader accepts it, else the reason for its rejection."""
        return self._receive(reader, delivery)


class _Fault:
    """Base of the faults: harms a share ``size`` of the messages and passes the others."""

    def __init__(self, fault: MessageFaultInterval, encode: Encode) -> None:
        self.harmed = 0
        self.fault = fault
        self.encode = encode
        self.rng = np.random.default_rng(fault.seed)

    def concerns(self, message: ReceivedMessage) -> bool:
        """Return True if the fault is active and the message is of its types."""
        return type(message.message) in self.fault.kinds and self.fault.interval.contains(message.received_t_ns)

    def deliveries(self, message: ReceivedMessage) -> list[Delivery]:
        """Return the deliveries of a message that the fault concerns."""
        if not self.meets(message):
            return [Delivery(message.received_t_ns, message)]
        self.harmed += 1
        return self.harm(message)

    def meets(self, message: ReceivedMessage) -> bool:  # noqa: ARG002  (overrides read it)
        """Return True if this message is to be harmed."""
        return bool(self.rng.random() < self.fault.size)

    def harm(self, message: ReceivedMessage) -> list[Delivery]:
        """Return the deliveries of a harmed message."""
        raise NotImplementedError


class _Loss(_Fault):
    def harm(self, message: ReceivedMessage) -> list[Delivery]:  # noqa: ARG002  (whatever it was)
        return []


class _Delay(_Fault):
    def meets(self, message: ReceivedMessage) -> bool:  # noqa: ARG002  (all are late by the same time)
        return True

    def harm(self, message: ReceivedMessage) -> list[Delivery]:
        return [Delivery(message.received_t_ns + round(1e9 * self.fault.size), message)]


class _Reorder(_Fault):
    """Fault that holds a message back until the next one of its type has passed."""

    def __init__(self, fault: MessageFaultInterval, encode: Encode) -> None:
        super().__init__(fault, encode)
        self._waiting: dict[type[Message], ReceivedMessage] = {}

    def concerns(self, message: ReceivedMessage) -> bool:
        return type(message.message) in self._waiting or super().concerns(message)

    def deliveries(self, message: ReceivedMessage) -> list[Delivery]:
        at_ns = message.received_t_ns
        waiting = self._waiting.pop(type(message.message), None)
        if waiting is not None:
            self.harmed += 1
            return [Delivery(at_ns, message), Delivery(at_ns, waiting)]
        if self.meets(message):
            self._waiting[type(message.message)] = message
            return []
        return [Delivery(at_ns, message)]


class _Duplicate(_Fault):
    def harm(self, message: ReceivedMessage) -> list[Delivery]:
        at_ns = message.received_t_ns
        return [Delivery(at_ns, message), Delivery(at_ns + AGAIN_NS, message)]


class _Corruption(_Fault):
    def harm(self, message: ReceivedMessage) -> list[Delivery]:
        payload = bytearray(self.encode(message))
        for _ in range(int(self.rng.integers(1, MAX_FLIPPED_BITS + 1))):
            bit = int(self.rng.integers(8 * len(payload)))
            payload[bit // 8] ^= 1 << bit % 8
        return [Delivery(message.received_t_ns, message, bytes(payload))]


class _NotANumber(_Fault):
    def harm(self, message: ReceivedMessage) -> list[Delivery]:
        signal = _parts(message.message)[-1]
        limits = bounds(type(signal)).items()
        fields = [name for name, of in limits if not of.has_gaps and _is_real(getattr(signal, name))]
        name = fields[int(self.rng.integers(len(fields)))]
        bad = NOT_NUMBERS[int(self.rng.integers(len(NOT_NUMBERS)))]
        values = np.array(getattr(signal, name), dtype=np.float64)
        values.flat[int(self.rng.integers(values.size))] = bad
        value = getattr(signal, name)
        new = tuple(values.tolist()) if isinstance(value, tuple) else values if values.ndim else bad
        harmed = msgspec.structs.replace(signal, **{name: new})
        return [Delivery(message.received_t_ns, _replaced(message, [*_parts(message.message)[:-1], harmed]))]


class _Stale(_Fault):
    """Fault that repeats the first message of its interval, stamps included, under new sequence numbers."""

    def __init__(self, fault: MessageFaultInterval, encode: Encode) -> None:
        super().__init__(fault, encode)
        self._first: dict[type[Message], Message] = {}

    def meets(self, message: ReceivedMessage) -> bool:
        kind = type(message.message)
        first = kind not in self._first
        self._first.setdefault(kind, message.message)
        return not first

    def harm(self, message: ReceivedMessage) -> list[Delivery]:
        return [Delivery(message.received_t_ns, _replaced(message, [self._first[type(message.message)]]))]


class _ClockJump(_Fault):
    def meets(self, message: ReceivedMessage) -> bool:  # noqa: ARG002  (it stamps all)
        return True

    def harm(self, message: ReceivedMessage) -> list[Delivery]:
        ahead_ns = round(1e9 * self.fault.size)
        parts = _parts(message.message)
        stamps = [name for name in STAMPS if name in parts[0].__struct_fields__]
        jumped = [
            msgspec.structs.replace(part, **{name: getattr(part, name) + ahead_ns for name in stamps}) for part in parts
        ]
        return [Delivery(message.received_t_ns, _replaced(message, jumped))]


STAMPS = ("t_ns", "from_t_ns", "cycle_t_ns")
"""Fields that a publisher stamps by its own clock."""

_FAULTS: Mapping[MessageFault, type[_Fault]] = {
    MessageFault.LOSS: _Loss,
    MessageFault.DELAY: _Delay,
    MessageFault.REORDER: _Reorder,
    MessageFault.DUPLICATE: _Duplicate,
    MessageFault.CORRUPTION: _Corruption,
    MessageFault.NOT_A_NUMBER: _NotANumber,
    MessageFault.STALE: _Stale,
    MessageFault.CLOCK_JUMP: _ClockJump,
}


def _is_real(value: Any) -> bool:
    if isinstance(value, np.ndarray):
        return value.dtype.kind == "f" and value.size > 0
    return isinstance(value[0] if isinstance(value, tuple) else value, float)


def _parts(signal: Message) -> Sequence[Message]:
    return signal.samples if isinstance(signal, ImuSamples) else (signal,)


def _replaced(message: ReceivedMessage, parts: Sequence[Message]) -> ReceivedMessage:
    """Return the received message with another content, or with other inertial samples."""
    samples = tuple(part for part in parts if isinstance(part, ImuSample))
    return msgspec.structs.replace(message, message=ImuSamples(samples=samples) if samples else parts[0])
