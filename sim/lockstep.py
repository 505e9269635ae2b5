"""Lock step: all nodes in one process on a simulated clock. The same nodes and the same seed give the same bits.

Time jumps from one event to the next; an event is a delivery or a step. At one instant deliveries that were on their
way come first, then steps in the order of the list of nodes: plant, sensors, estimator, controller. A signal is handed
at once to every node that reads its type, with two exceptions:

- what a ``Cycle`` node writes arrives ``compute_delay_ns`` after the start of its cycle, exactly; until then the cycle
  is in flight and the next one waits (one solve at a time). With no delay the plan arrives at the same instant, when
  the plant, first in the list, has already stepped: it acts on the plan in its next step;
- of a type in ``latest`` an inbox holds the newest only.

Whoever calls a cycle measures it. Here nothing is measured: a cycle that made a plan is followed by a ``CycleTiming``
that says ``compute_delay_ns``, no wall time and no stages.

``between`` stands where the bus stands between processes: what it does to messages is done outside every node. With
none a message arrives as it was published, and validation is its only check.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple, Protocol, TypeAlias

from ltv_mpc.messages import CycleTiming, Estimate, Message, Plan, Rejected
from ltv_mpc.node import Arrival, Grid, Inbox, Node, OnMessage
from ltv_mpc.validation import refusal

EPOCH = 1
"""The epoch of every node: in lock step none restarts."""

LATEST: frozenset[type[Message]] = frozenset({Estimate})
"""Types of which a reader wants the newest value only."""

Cause: TypeAlias = str | type[Message]
"""``"grid"``, ``"cycle"`` or the type of the message that caused a step."""

Refuse: TypeAlias = Callable[[str, Arrival, str], Rejected]
"""Node, what arrived, reason -> the signal that says so."""


class Observer(Protocol):
    """Sees everything in order: each step before its outputs, each signal at its publication."""

    def stepped(self, at_ns: int, node: str, number: int, t_ns: int, cause: Cause, inbox: Inbox) -> None:
        """Step ``number`` of ``node`` (from 0) for ``t_ns`` took this inbox when the clock stood at ``at_ns``."""
        ...

    def published(self, node: str, message: Arrival) -> None:
        """``node`` published this at ``message.received_t_ns``; its sequence counts by type from 0."""
        ...


class Delivery(NamedTuple):
    """A copy of a message on its way to one reader. ``payload``: these bytes arrive in the message's place."""

    at_ns: int
    message: Arrival
    payload: bytes | None = None


class Between(Protocol):
    """Carries every message to each of its readers, and keeps the readers' doors."""

    def carry(self, writer: str, reader: str, message: Arrival) -> Sequence[Delivery]:
        """What comes of a message published at ``message.received_t_ns``, and when; nothing: it is lost."""
        ...

    def admit(self, reader: str, delivery: Delivery) -> Arrival | str:
        """What the reader's door lets in, or why not."""
        ...


def refused_by_name(node: str, message: Arrival, reason: str) -> Rejected:
    """What a node is told of a refused signal where no wire has given it a key, a crc and a payload."""
    kind = type(message.signal).__name__
    return Rejected(t_ns=message.received_t_ns, node=node, key=kind, reason=reason, crc=0, payload_base64="")


class _Seat:
    """A node's place at the table: what it is asked for, and its inbox."""

    __slots__ = ("causes", "inbox", "index", "name", "reads", "sequences", "step", "steps")

    def __init__(self, index: int, node: Node) -> None:
        self.index = index
        self.name = node.name
        self.step = node.step
        self.reads = frozenset(node.reads)
        self.causes = frozenset(node.schedule.types if isinstance(node.schedule, OnMessage) else ())
        self.inbox: list[Arrival] = []
        self.sequences: dict[type[Message], int] = {}  # of the next signal of a type
        self.steps = 0


_IN_FLIGHT = -1  # stands where a seat's index stands, before all of them


class LockStep:
    """The nodes of one run between ``start_ns`` and wherever ``advance`` has taken it.

    ``compute_delay_ns`` is one for all cycles, or a function of a cycle's start. ``observe`` sees everything,
    ``latest`` names the types of which a reader wants the newest only, ``refused`` words the ``Rejected`` for what
    validation refuses.
    """

    def __init__(
        self,
        nodes: Sequence[Node],
        *,
        start_ns: int,
        compute_delay_ns: int | Callable[[int], int] = 0,
        observe: Observer | None = None,
        latest: frozenset[type[Message]] = LATEST,
        refused: Refuse = refused_by_name,
        between: Between | None = None,
    ) -> None:
        self._compute_delay_ns = compute_delay_ns if callable(compute_delay_ns) else lambda _: compute_delay_ns
        self._observe = observe
        self._between = between
        self._latest = latest
        self._refused = refused
        self._seats = [_Seat(index, node) for index, node in enumerate(nodes)]
        self._readers: dict[type[Message], list[_Seat]] = {}
        # (time, seat, count, what happens then): the count keeps the order of what falls together at one seat.
        self._events: list[tuple[int, int, int, Callable[[int], None]]] = []
        self._count = 0
        for seat, node in zip(self._seats, nodes, strict=True):
            for kind in node.reads:
                self._readers.setdefault(kind, []).append(seat)
            if not isinstance(node.schedule, OnMessage):
                period_ns = node.schedule.period_ns
                tick = self._grid if isinstance(node.schedule, Grid) else self._cycle
                first_ns = -(-start_ns // period_ns) * period_ns  # on the grid k x period, not before the start
                self._push(first_ns, seat.index, partial(tick, seat, period_ns))

    @property
    def steps(self) -> dict[str, int]:
        """Steps done so far by each node."""
        return {seat.name: seat.steps for seat in self._seats}

    def advance(self, until_ns: int) -> None:
        """Every event up to and including ``until_ns``."""
        events, pop = self._events, heapq.heappop
        while events and events[0][0] <= until_ns:
            at_ns, _, _, act = pop(events)
            act(at_ns)

    def _push(self, at_ns: int, index: int, act: Callable[[int], None]) -> None:
        self._count += 1
        heapq.heappush(self._events, (at_ns, index, self._count, act))

    def _grid(self, seat: _Seat, period_ns: int, at_ns: int) -> None:
        self._push(at_ns + period_ns, seat.index, partial(self._grid, seat, period_ns))
        self._publish(seat, self._step(seat, at_ns, at_ns, "grid"), at_ns)

    def _on_message(self, seat: _Seat, message: Arrival, at_ns: int) -> None:
        seat.inbox.append(message)
        signal: Any = message.signal  # a type that causes steps has its validity time
        self._publish(seat, self._step(seat, at_ns, signal.t_ns, type(signal)), at_ns)

    def _cycle(self, seat: _Seat, period_ns: int, at_ns: int) -> None:
        outputs = self._step(seat, at_ns, at_ns, "cycle")
        plan = next((signal for signal in outputs if isinstance(signal, Plan)), None)
        delay_ns = 0 if plan is None else self._compute_delay_ns(at_ns)  # without a plan nothing was computed
        if plan is not None:
            outputs = [*outputs, timing_of(plan, at_ns, delay_ns)]
        if delay_ns:
            self._push(at_ns + delay_ns, _IN_FLIGHT, partial(self._publish, seat, outputs))
        else:
            self._publish(seat, outputs, at_ns)
        self._push(at_ns + max(period_ns, delay_ns), seat.index, partial(self._cycle, seat, period_ns))

    def _step(self, seat: _Seat, at_ns: int, t_ns: int, cause: Cause) -> list[Message]:
        inbox, seat.inbox = seat.inbox, []
        if self._observe is not None:
            self._observe.stepped(at_ns, seat.name, seat.steps, t_ns, cause, inbox)
        seat.steps += 1
        return seat.step(t_ns, inbox)

    def _publish(self, seat: _Seat, signals: list[Message], at_ns: int) -> None:
        for signal in signals:
            message = self._numbered(seat, signal, at_ns)
            readers = self._readers.get(type(signal))
            if not readers:
                continue
            if self._between is not None:
                for reader in readers:
                    self._send(self._between, seat, reader, message)
                continue
            reason = refusal(signal)
            for reader in readers:
                if reason is None:
                    self._deliver(reader, message)
                else:
                    self._reject(reader, message, reason, at_ns)

    def _send(self, between: Between, seat: _Seat, reader: _Seat, message: Arrival) -> None:
        for delivery in between.carry(seat.name, reader.name, message):
            if delivery.at_ns <= message.received_t_ns:
                self._arrive(between, reader, delivery, message.received_t_ns)
            else:
                self._push(delivery.at_ns, _IN_FLIGHT, partial(self._arrive, between, reader, delivery))

    def _arrive(self, between: Between, reader: _Seat, delivery: Delivery, at_ns: int) -> None:
        admitted = between.admit(reader.name, delivery)
        if isinstance(admitted, str):
            self._reject(reader, delivery.message, admitted, at_ns)
        else:
            self._deliver(reader, Arrival(admitted.signal, admitted.epoch, admitted.sequence, at_ns))

    def _reject(self, reader: _Seat, message: Arrival, reason: str, at_ns: int) -> None:
        rejected = self._numbered(reader, self._refused(reader.name, message, reason), at_ns)
        if Rejected in reader.reads:
            reader.inbox.append(rejected)

    def _numbered(self, seat: _Seat, signal: Message, at_ns: int) -> Arrival:
        message = numbered(signal, seat.sequences, at_ns)
        if self._observe is not None:
            self._observe.published(seat.name, message)
        return message

    def _deliver(self, reader: _Seat, message: Arrival) -> None:
        kind = type(message.signal)
        if kind in reader.causes:
            self._push(message.received_t_ns, reader.index, partial(self._on_message, reader, message))
            return
        if kind in self._latest:
            reader.inbox = [earlier for earlier in reader.inbox if type(earlier.signal) is not kind]
        reader.inbox.append(message)


def numbered(signal: Message, sequences: dict[type[Message], int], at_ns: int) -> Arrival:
    """As it is published; ``sequences`` are the next ones of its writer by type, and are kept up."""
    kind = type(signal)
    sequence = sequences.get(kind, 0)
    sequences[kind] = sequence + 1
    return Arrival(signal, EPOCH, sequence, at_ns)


def timing_of(plan: Plan, start_ns: int, delay_ns: int) -> CycleTiming:
    """What a cycle from ``start_ns`` is said to have cost."""
    return CycleTiming(
        t_ns=start_ns,
        compute_ns=delay_ns,
        compute_wall_ns=0,
        estimate_age_ns=start_ns - plan.estimate_t_ns,
        stage_us={},
    )


def run(
    nodes: Sequence[Node],
    *,
    start_ns: int,
    end_ns: int,
    compute_delay_ns: int = 0,
    observe: Observer | None = None,
) -> LockStep:
    """All of ``start_ns`` to ``end_ns``, both included."""
    lockstep = LockStep(nodes, start_ns=start_ns, compute_delay_ns=compute_delay_ns, observe=observe)
    lockstep.advance(end_ns)
    return lockstep
