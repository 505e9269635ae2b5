"""Message faults: loss, delay, reordering, duplication, corruption, non-finite values, stale data and wrong stamps.

``MessageFaults`` is a transport between the nodes of a lock step (``sim.scheduler.Between``). A message passes
through the first active fault that concerns its type; all others arrive as published. Harmed messages are counted,
so that the readers' own counts can be compared with them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import msgspec
import numpy as np

from ltv_mpc.messages import Message, MessageFault
from ltv_mpc.node import ReceivedMessage
from ltv_mpc.validation import bounds
from sim.faults.interval import Interval
from sim.scheduler import Delivery


class MessageFaultInterval(NamedTuple):
    """One fault. ``size`` is, by harm:

    loss, reorder, duplicate, corruption, not a number: the share of messages that meets it; delay: seconds; clock
    jump: seconds that stamps are ahead of the time. A stale one has none.
    """

    kinds: tuple[type[Message], ...]
    harm: MessageFault
    interval: Interval
    size: float
    seed: int


Encode = Callable[[ReceivedMessage], bytes]
"""A message as the bytes that travel: what stands in a frame is no affair of this file."""

Admit = Callable[[str, Delivery], ReceivedMessage | str]
"""The door of a reader, by the reader's name."""

AGAIN_NS = 40_000_000
"""A message that comes twice comes the second time so much later."""

MOST_FLIPPED = 8
"""Bits of one frame."""

NOT_NUMBERS = (math.nan, math.inf, -math.inf)


class MessageFaults:
    """All that stands between the nodes of one run."""

    def __init__(self, faults: Sequence[MessageFaultInterval], *, encode: Encode, admit: Admit) -> None:
        self._harms: list[_Harm] = []
        self._kinds: set[type[Message]] = set()
        self._encode = encode
        self._admit = admit
        for fault in faults:
            self.add(fault)

    def add(self, fault: MessageFaultInterval) -> None:
        """One more, from now on."""
        self._harms.append(_HARMS[fault.harm](fault, self._encode))
        self._kinds.update(fault.kinds)

    @property
    def harmed(self) -> list[int]:
        """Of each fault, in the order given: how many messages it has harmed."""
        return [harm.harmed for harm in self._harms]

    def covers(self, kind: type[Message]) -> bool:
        """Whether any fault concerns messages of this type, now or at another time."""
        return kind in self._kinds

    def carry(self, writer: str, reader: str, message: ReceivedMessage) -> Sequence[Delivery]:  # noqa: ARG002  (a type is a key)
        """What comes of it on the way to ``reader``: by the first fault that lasts and concerns its type."""
        if type(message.message) in self._kinds:
            for harm in self._harms:
                if harm.concerns(message):
                    return harm.deliveries(message)
        return [Delivery(message.received_t_ns, message)]

    def receive(self, reader: str, delivery: Delivery) -> ReceivedMessage | str:
        """By the reader's door."""
        return self._admit(reader, delivery)


class _Harm:
    """A harm that meets a share ``size`` of the messages; the others pass."""

    def __init__(self, fault: MessageFaultInterval, encode: Encode) -> None:
        self.harmed = 0
        self.fault = fault
        self.encode = encode
        self.rng = np.random.default_rng(fault.seed)

    def concerns(self, message: ReceivedMessage) -> bool:
        """Whether it lasts, and the message is of its types."""
        return type(message.message) in self.fault.kinds and self.fault.interval.contains(message.received_t_ns)

    def deliveries(self, message: ReceivedMessage) -> list[Delivery]:
        """What comes of a message that it concerns."""
        if not self.meets(message):
            return [Delivery(message.received_t_ns, message)]
        self.harmed += 1
        return self.harm(message)

    def meets(self, message: ReceivedMessage) -> bool:  # noqa: ARG002  (others look at it)
        """Whether it harms this one."""
        return bool(self.rng.random() < self.fault.size)

    def harm(self, message: ReceivedMessage) -> list[Delivery]:
        """What comes of a harmed one."""
        raise NotImplementedError


class _Loss(_Harm):
    def harm(self, message: ReceivedMessage) -> list[Delivery]:  # noqa: ARG002  (whatever it was)
        return []


class _Delay(_Harm):
    def meets(self, message: ReceivedMessage) -> bool:  # noqa: ARG002  (all are late by the same time)
        return True

    def harm(self, message: ReceivedMessage) -> list[Delivery]:
        return [Delivery(message.received_t_ns + round(1e9 * self.fault.size), message)]


class _Reorder(_Harm):
    """A message waits until the next one of its type has gone before it."""

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


class _Duplicate(_Harm):
    def harm(self, message: ReceivedMessage) -> list[Delivery]:
        at_ns = message.received_t_ns
        return [Delivery(at_ns, message), Delivery(at_ns + AGAIN_NS, message)]


class _Corruption(_Harm):
    def harm(self, message: ReceivedMessage) -> list[Delivery]:
        payload = bytearray(self.encode(message))
        for _ in range(int(self.rng.integers(1, MOST_FLIPPED + 1))):
            bit = int(self.rng.integers(8 * len(payload)))
            payload[bit // 8] ^= 1 << bit % 8
        return [Delivery(message.received_t_ns, message, bytes(payload))]


class _NotANumber(_Harm):
    def harm(self, message: ReceivedMessage) -> list[Delivery]:
        signal = message.message
        limits = bounds(type(signal)).items()
        fields = [name for name, of in limits if not of.has_gaps and _is_real(getattr(signal, name))]
        name = fields[int(self.rng.integers(len(fields)))]
        bad = NOT_NUMBERS[int(self.rng.integers(len(NOT_NUMBERS)))]
        values = np.array(getattr(signal, name), dtype=np.float64)
        values.flat[int(self.rng.integers(values.size))] = bad
        value = getattr(signal, name)
        new = tuple(values.tolist()) if isinstance(value, tuple) else values if values.ndim else bad
        return [Delivery(message.received_t_ns, _with(message, **{name: new}))]


class _Stale(_Harm):
    """The publisher says again and again what it said last before, stamps and all, as new messages."""

    def __init__(self, fault: MessageFaultInterval, encode: Encode) -> None:
        super().__init__(fault, encode)
        self._said: dict[type[Message], Message] = {}

    def meets(self, message: ReceivedMessage) -> bool:
        kind = type(message.message)
        first = kind not in self._said
        self._said.setdefault(kind, message.message)
        return not first

    def harm(self, message: ReceivedMessage) -> list[Delivery]:
        return [Delivery(message.received_t_ns, _replaced(message, self._said[type(message.message)]))]


class _ClockJump(_Harm):
    def meets(self, message: ReceivedMessage) -> bool:  # noqa: ARG002  (it stamps all)
        return True

    def harm(self, message: ReceivedMessage) -> list[Delivery]:
        ahead_ns = round(1e9 * self.fault.size)
        stamps = [name for name in STAMPS if name in message.message.__struct_fields__]
        jumped = {name: getattr(message.message, name) + ahead_ns for name in stamps}
        return [Delivery(message.received_t_ns, _with(message, **jumped))]


STAMPS = ("t_ns", "from_t_ns", "cycle_t_ns")
"""What a publisher stamps by its own clock."""

_HARMS: Mapping[MessageFault, type[_Harm]] = {
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


def _with(message: ReceivedMessage, **values: Any) -> ReceivedMessage:
    return _replaced(message, msgspec.structs.replace(message.message, **values))


def _replaced(message: ReceivedMessage, signal: Message) -> ReceivedMessage:
    return msgspec.structs.replace(message, message=signal)
