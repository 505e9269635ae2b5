"""Message faults: loss, delay, reordering, duplication, corruption, non-finite values, stale data and wrong stamps.

``MessageFaults`` carries the messages between the nodes of a ``FaultyLockStep``, in the place of the bus between
processes. A message passes through the first active fault that concerns its type; all others arrive as published.
Harmed messages are counted, so that the readers' own counts can be compared with them.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import msgspec
import numpy as np

from benchmarks.faults.effects import Interval
from ltv_mpc.messages import ImuSample, ImuSamples, Message
from ltv_mpc.node import Node, ReceivedMessage
from ltv_mpc.validation import bounds
from sim.scheduler import PENDING, LockStep


class Delivery(NamedTuple):
    """Copy of a message that reaches one reader."""

    at_ns: int
    message: ReceivedMessage
    payload: bytes | None = None  # bytes that arrive instead of the message


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
    """Way of the messages of one run, with its faults."""

    def __init__(self, faults: Sequence[MessageFaultInterval], *, encode: Encode, receive: Admit) -> None:
        self._faults = [_Fault(fault, encode) for fault in faults]
        self._kinds = {kind for fault in faults for kind in fault.kinds}
        self._receive = receive

    @property
    def harmed(self) -> list[int]:
        """Number of messages that each fault has harmed, in the order of the faults."""
        return [fault.harmed for fault in self._faults]

    def covers(self, kind: type[Message]) -> bool:
        """Return True if any fault concerns messages of this type, active or not."""
        return kind in self._kinds

    def carry(self, writer: str, reader: str, message: ReceivedMessage) -> Sequence[Delivery]:  # noqa: ARG002  (a type is a key)
        """Return the deliveries of a message; the first active fault that concerns its type decides."""
        if type(message.message) in self._kinds:
            for fault in self._faults:
                if fault.concerns(message):
                    return fault.deliveries(message)
        return [Delivery(message.received_t_ns, message)]

    def receive(self, reader: str, delivery: Delivery) -> ReceivedMessage | str:
        """Return the message if the reader accepts it, else the reason for its rejection."""
        return self._receive(reader, delivery)


class FaultyLockStep(LockStep):
    """Lock step whose messages take the way of ``faults``, which also decide if a reader accepts them."""

    def __init__(self, faults: MessageFaults, nodes: Sequence[Node], **settings: Any) -> None:
        super().__init__(nodes, **settings)
        self._faults = faults

    def _carry(self, writer: str, route: Any, received: ReceivedMessage) -> None:
        for reader in route.readers:
            for delivery in self._faults.carry(writer, reader.name, received):
                arrive = partial(self._arrive, reader, delivery)
                if delivery.at_ns <= received.received_t_ns:
                    arrive(received.received_t_ns)
                else:
                    self._schedule(delivery.at_ns, PENDING, partial(arrive, delivery.at_ns))

    def _arrive(self, reader: Any, delivery: Delivery, at_ns: int) -> None:
        accepted = self._faults.receive(reader.name, delivery)
        if isinstance(accepted, str):
            self._reject(reader, delivery.message, accepted, at_ns)
        else:
            self._deliver(reader, ReceivedMessage(accepted.message, accepted.epoch, accepted.sequence, at_ns))


class _Fault:
    """One fault and its state: it harms a share ``size`` of the messages, or all, and passes the others."""

    def __init__(self, fault: MessageFaultInterval, encode: Encode) -> None:
        self.harmed = 0
        self._fault = fault
        self._encode = encode
        self._rng = np.random.default_rng(fault.seed)
        self._kept: dict[type[Message], ReceivedMessage] = {}
        """Message of a type that waits for its successor, or that is repeated."""

    def concerns(self, message: ReceivedMessage) -> bool:
        """Return True if the fault is active and the message is of its types, or another one waits for this."""
        kind, harm = type(message.message), self._fault.harm
        is_active = kind in self._fault.kinds and self._fault.interval.contains(message.received_t_ns)
        return is_active or (harm is MessageFault.REORDER and kind in self._kept)

    def deliveries(self, message: ReceivedMessage) -> list[Delivery]:
        """Return the deliveries of a message that the fault concerns."""
        at_ns, kind, harm, size = message.received_t_ns, type(message.message), self._fault.harm, self._fault.size
        unharmed = Delivery(at_ns, message)
        if harm is MessageFault.REORDER and kind in self._kept:
            self.harmed += 1
            return [unharmed, Delivery(at_ns, self._kept.pop(kind))]
        if harm is MessageFault.STALE and kind not in self._kept:
            self._kept[kind] = message
            return [unharmed]
        if harm not in (MessageFault.DELAY, MessageFault.STALE, MessageFault.CLOCK_JUMP) and self._rng.random() >= size:
            return [unharmed]
        self.harmed += harm is not MessageFault.REORDER  # else when its successor has passed
        match harm:
            case MessageFault.LOSS:
                return []
            case MessageFault.REORDER:
                self._kept[kind] = message
                return []
            case MessageFault.DELAY:
                return [Delivery(at_ns + round(1e9 * size), message)]
            case MessageFault.DUPLICATE:
                return [unharmed, Delivery(at_ns + AGAIN_NS, message)]
            case MessageFault.CORRUPTION:
                return [Delivery(at_ns, message, self._corrupted(message))]
            case MessageFault.NOT_A_NUMBER:
                parts = self._with_bad_number(message.message)
            case MessageFault.STALE:  # stamps included, under new sequence numbers
                parts = [self._kept[kind].message]
            case MessageFault.CLOCK_JUMP:
                parts = [_ahead(part, round(1e9 * size)) for part in _parts(message.message)]
        samples = tuple(part for part in parts if isinstance(part, ImuSample))
        content = ImuSamples(samples=samples) if samples else parts[0]
        return [Delivery(at_ns, msgspec.structs.replace(message, message=content))]

    def _corrupted(self, message: ReceivedMessage) -> bytes:
        payload = bytearray(self._encode(message))
        for _ in range(int(self._rng.integers(1, MAX_FLIPPED_BITS + 1))):
            bit = int(self._rng.integers(8 * len(payload)))
            payload[bit // 8] ^= 1 << bit % 8
        return bytes(payload)

    def _with_bad_number(self, signal: Message) -> list[Message]:
        *others, last = _parts(signal)
        limits = bounds(type(last)).items()
        fields = [name for name, of in limits if not of.has_gaps and _is_real(getattr(last, name))]
        name = fields[int(self._rng.integers(len(fields)))]
        bad = NOT_NUMBERS[int(self._rng.integers(len(NOT_NUMBERS)))]
        value = getattr(last, name)
        values = np.array(value, dtype=np.float64)
        values.flat[int(self._rng.integers(values.size))] = bad
        new = tuple(values.tolist()) if isinstance(value, tuple) else values if values.ndim else bad
        return [*others, msgspec.structs.replace(last, **{name: new})]


STAMPS = ("t_ns", "from_t_ns", "cycle_t_ns")
"""Fields that a publisher stamps by its own clock."""


def _ahead(part: Message, ahead_ns: int) -> Message:
    stamps = {name: getattr(part, name) + ahead_ns for name in STAMPS if name in part.__struct_fields__}
    return msgspec.structs.replace(part, **stamps)


def _is_real(value: Any) -> bool:
    if isinstance(value, np.ndarray):
        return value.dtype.kind == "f" and value.size > 0
    return isinstance(value[0] if isinstance(value, tuple) else value, float)


def _parts(signal: Message) -> Sequence[Message]:
    return signal.samples if isinstance(signal, ImuSamples) else (signal,)
