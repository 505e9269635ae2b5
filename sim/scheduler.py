"""Lock step: all nodes of a run in one process on a simulated clock. One seed gives the same bits in every run.

At one instant pending deliveries come first, then steps in the order of the list of nodes: plant, sensors, estimator,
controller. A message is delivered at once to every node that reads its type, with two exceptions:

- The output of a ``Cycle`` node arrives exactly ``compute_delay_ns`` after the start of its cycle. Until then the cycle
  is in flight and the next one waits: there is one solve at a time. Without delay the plan arrives at the same
  instant. The plant, first in the list, has then already stepped, so it acts on the plan in its next step.
- Of a type in ``latest`` an inbox holds the newest message only.

The scheduler advances by time windows (conservative lookahead). A window ends at the next instant at which a node could
read something that a node at its own place or after it in the list writes: at the next cycle, at the next step of a
node on a grid that writes such a type, or at the next pending delivery. Within a window each node in turn takes all its
steps in one call of ``steps``, with all messages that the nodes before it have published by then. A window is a single
step in three cases: a node on messages writes such a type, a node other than a cycle reads rejections, or a
``transport`` carries the messages. The length of the windows affects the speed of a run and nothing else.

Observers are notified at the end of each window, in the order of the events. A node may then be ahead of the event
that is reported. An observer that inspects a node during the run therefore wraps it in a node that takes the steps one
at a time.

The caller of a cycle measures it. Here nothing is measured: a cycle that made a plan is followed by a ``CycleTiming``
with ``compute_delay_ns``, no wall time and no stages.
"""

from __future__ import annotations

import heapq
from bisect import bisect_right
from collections.abc import Callable, Sequence
from functools import partial
from itertools import count
from operator import itemgetter
from typing import Any, NamedTuple, Protocol, TypeAlias

from ltv_mpc.messages import CycleTiming, Estimate, Message, Plan, RejectedFrame
from ltv_mpc.node import Cycle, Due, Inbox, Node, OnMessage, ReceivedMessage
from ltv_mpc.validation import validator

EPOCH = 1
"""Epoch of every node: in lock step no node restarts."""

LATEST: frozenset[type[Message]] = frozenset({Estimate})
"""Types of which a reader receives the newest message only."""

Cause: TypeAlias = str | type[Message]
"""Cause of a step: ``"grid"``, ``"cycle"`` or the type of the message that caused it."""

MakeRejection: TypeAlias = Callable[[str, ReceivedMessage, str], RejectedFrame]
"""Function of node, received message and reason that returns the rejection message."""


class Step(NamedTuple):
    """One step of a node."""

    at_ns: int  # clock at the step
    node: str
    number: int  # of the node's steps, from 0
    t_ns: int  # vehicle time that the step is for
    cause: Cause
    inbox: Inbox


class Observer(Protocol):
    """Observer of the messages of a run, notified in the order of their publication."""

    def published(self, node: str, message: ReceivedMessage) -> None:
        """Handle a message that ``node`` published at ``message.received_t_ns``.

        The sequence number counts the node's messages of one type from 0.
        """
        ...


class Observation(NamedTuple):
    """Observer of a run, and what it is notified of."""

    observer: Observer | None = None
    types: frozenset[type[Message]] | None = None  # of messages; None: all
    on_step: Callable[[Step], None] | None = None  # called with each step, before the step's messages


NO_OBSERVATION = Observation()


class Delivery(NamedTuple):
    """Copy of a message that a transport delivers to one reader."""

    at_ns: int
    message: ReceivedMessage
    payload: bytes | None = None  # bytes that arrive instead of the message


class Transport(Protocol):
    """Carrier of all messages between nodes, in the place of the bus between processes.

    Without a transport a message arrives as published and is checked by validation only.
    """

    def carry(self, writer: str, reader: str, message: ReceivedMessage) -> Sequence[Delivery]:
        """Return the deliveries that a message published at ``message.received_t_ns`` leads to; none: it is lost."""
        ...

    def receive(self, reader: str, delivery: Delivery) -> ReceivedMessage | str:
        """Return the message if the reader accepts it, else the reason for its rejection."""
        ...


def rejected_by_type_name(node: str, message: ReceivedMessage, reason: str) -> RejectedFrame:
    """Return the rejection of a message that has no frame: its type for the key, and neither crc nor payload."""
    kind = type(message.message).__name__
    return RejectedFrame(t_ns=message.received_t_ns, node=node, key=kind, reason=reason, crc=0, payload_base64="")


EventOrder: TypeAlias = tuple[int, int, int, int]
"""Sort key of all events: time, place of the node in the list (-1: a pending delivery), count of steps, and count of
that step's messages that were rejected. Events with equal keys keep the order of publication."""

_PENDING = -1

_by_order = itemgetter(0)


class _Rejection(NamedTuple):
    """Message that one reader has rejected."""

    order: EventOrder
    reader: _ScheduledNode
    message: ReceivedMessage
    reason: str


class _Route:
    """Readers of one node's messages of one type, looked up once for each type."""

    __slots__ = ("inboxes", "observed", "published", "readers", "validate", "wakes")

    def __init__(self, kind: type[Message], readers: Sequence[_ScheduledNode], observed: bool) -> None:
        self.validate = validator(kind)
        self.readers = tuple(readers)
        self.inboxes = tuple(reader.inbox_of(kind).append for reader in readers)
        self.wakes = tuple(reader for reader in readers if reader.ends_window and kind in reader.causes)
        self.observed = observed
        self.published = 0

    def numbered(self, message: Message, at_ns: int) -> ReceivedMessage:
        """Return the message with the next sequence number."""
        number = self.published
        self.published = number + 1
        return ReceivedMessage(message, EPOCH, number, at_ns)


class _ScheduledNode:
    """Node with its next due time and the messages that wait for it."""

    def __init__(self, index: int, node: Node, start_ns: int, latest: frozenset[type[Message]]) -> None:
        self.index, self.name, self.node = index, node.name, node
        self.rank = index  # order of its messages among all that are published at one instant
        self.ends_window = False  # True if each of its steps ends a time window
        schedule = node.schedule
        self.cycles = isinstance(schedule, Cycle)
        self.causes = frozenset(schedule.types if isinstance(schedule, OnMessage) else ())
        self.period_ns = 0 if isinstance(schedule, OnMessage) else schedule.period_ns
        # On the grid k x period, not before the start.
        self.next_ns = -(-start_ns // self.period_ns) * self.period_ns if self.period_ns else 0
        self._latest = latest.intersection(node.reads) - self.causes
        self.waiting: list[tuple[EventOrder, ReceivedMessage]] = []
        self.causing: list[tuple[EventOrder, ReceivedMessage]] = []
        self.routes: dict[type[Message], _Route] = {}
        self.steps = 0

    def inbox_of(self, kind: type[Message]) -> list[tuple[EventOrder, ReceivedMessage]]:
        """Return the list for messages of a type: those that cause a step, or those that wait for the next one."""
        return self.causing if kind in self.causes else self.waiting

    def due(self, last_ns: int, *, one: bool = False) -> tuple[list[int], list[Due]]:
        """Return the times and inboxes of all steps due up to ``last_ns``, or of the first one only (``one``)."""
        return self._by_time(last_ns) if self.period_ns else self._by_messages(last_ns, one=one)

    def _by_time(self, last_ns: int) -> tuple[list[int], list[Due]]:
        times = list(range(self.next_ns, last_ns + 1, self.period_ns))
        if times:
            self.next_ns = times[-1] + self.period_ns
        return times, [(t_ns, self._take(t_ns) if self.waiting else []) for t_ns in times]

    def _by_messages(self, last_ns: int, *, one: bool) -> tuple[list[int], list[Due]]:
        causing = self.causing
        causing.sort(key=_by_order)
        number = 1 if one else bisect_right(causing, last_ns, key=_time_of)
        times: list[int] = []
        due: list[Due] = []
        for (at_ns, *_), received in causing[:number]:
            message: Any = received.message  # a type that causes steps has its validity time
            times.append(at_ns)
            due.append((message.t_ns, [*self._take(at_ns), received] if self.waiting else [received]))
        del causing[:number]
        return times, due

    def _take(self, at_ns: int) -> list[ReceivedMessage]:
        """Take the messages that have arrived by then.

        Messages of nodes later in the list at that same instant are not published yet.
        """
        waiting = self.waiting
        waiting.sort(key=_by_order)
        number = bisect_right(waiting, at_ns, key=_time_of)
        inbox = [message for _, message in waiting[:number]]
        del waiting[:number]
        if not self._latest:
            return inbox
        newest = {type(message.message): message for message in inbox}
        return [m for m in inbox if type(m.message) not in self._latest or newest[type(m.message)] is m]


def _time_of(entry: tuple[EventOrder, ReceivedMessage]) -> int:
    return entry[0][0]


class _EventLog:
    """Steps and messages of a time window, and the observers that are notified of them at its end."""

    def __init__(self, observation: Observation) -> None:
        self._observer, types, self._on_step = observation
        self._types = frozenset[type[Message]]() if self._observer is None else types
        self._events: list[tuple[EventOrder, str, Step | ReceivedMessage]] = []

    @property
    def wants_steps(self) -> bool:
        """True if an observer is notified of steps."""
        return self._on_step is not None

    def wants(self, kind: type[Message]) -> bool:
        """Return True if an observer is notified of messages of this type."""
        return self._types is None or kind in self._types

    def add(self, order: EventOrder, node: str, event: Step | ReceivedMessage) -> None:
        """Add a step or a published message of ``node``."""
        self._events.append((order, node, event))

    def notify(self) -> None:
        """Notify the observers of all events since the last call, in the order of the events."""
        events, self._events = self._events, []
        events.sort(key=_by_order)
        for _, node, event in events:
            if type(event) is Step:
                assert self._on_step is not None
                self._on_step(event)
            elif self._observer is not None:
                self._observer.published(node, event)  # type: ignore[arg-type]


class LockStep:
    """Lock step of the nodes of one run, from ``start_ns`` to the time that ``advance`` has reached."""

    def __init__(
        self,
        nodes: Sequence[Node],
        *,
        start_ns: int,
        compute_delay_ns: int | Callable[[int], int] = 0,
        observation: Observation = NO_OBSERVATION,
        latest: frozenset[type[Message]] = LATEST,
        make_rejection: MakeRejection = rejected_by_type_name,
        transport: Transport | None = None,
    ) -> None:
        """Schedule the nodes.

        Parameters
        ----------
        nodes : nodes in the order in which they step at one instant.
        start_ns : vehicle time of the start (ns).
        compute_delay_ns : delay of a cycle's output (ns): one for all cycles, or a function of a cycle's start.
        observation : observer of messages and steps.
        latest : types of which a reader receives the newest message only.
        make_rejection : returns the message that reports a rejected one.
        transport : carries all messages; None: they arrive as published.
        """
        self._compute_delay_ns = compute_delay_ns if callable(compute_delay_ns) else lambda _: compute_delay_ns
        self._log = _EventLog(observation)
        self._make_rejection = make_rejection
        self._transport = transport
        self._nodes = [_ScheduledNode(index, node, start_ns, latest) for index, node in enumerate(nodes)]
        _find_window_ends(self._nodes, singly=transport is not None)
        self._batched = [node for node in self._nodes if not node.ends_window]
        self._readers: dict[type[Message], list[_ScheduledNode]] = {}
        for node in self._nodes:
            for kind in node.node.reads:
                self._readers.setdefault(kind, []).append(node)
        self._count = count()
        # A heap of the events that end time windows: time, place in the list, a count, and the action.
        self._events: list[tuple[int, int, int, Callable[[], None]]] = []
        for node in self._nodes:
            if node.ends_window and node.period_ns:
                self._schedule(node.next_ns, node.index, partial(self._step_once, node, node.next_ns))
        self._rejections: list[_Rejection] = []

    @property
    def steps(self) -> dict[str, int]:
        """Number of steps of each node so far."""
        return {node.name: node.steps for node in self._nodes}

    @property
    def published(self) -> int:
        """Number of messages of all nodes so far."""
        return sum(route.published for node in self._nodes for route in node.routes.values())

    def advance(self, until_ns: int) -> None:
        """Simulate all events up to and including ``until_ns``."""
        try:
            while self._advance_window(until_ns):
                pass
        finally:
            self._notify()

    def _advance_window(self, until_ns: int) -> bool:
        """Advance to the next event that ends a time window, and execute it; return False if there is none."""
        events = self._events
        event = heapq.heappop(events) if events and events[0][0] <= until_ns else None
        end_ns, index = (until_ns + 1, _PENDING) if event is None else event[:2]
        for node in self._batched:
            times_ns, due = node.due(end_ns if node.index < index else end_ns - 1)
            if due:
                self._publish(node, *self._step(node, times_ns, due))
        self._notify()
        if event is not None:
            event[-1]()
        return event is not None

    def _step_once(self, node: _ScheduledNode, at_ns: int) -> None:
        """Take one step of a node whose steps end time windows, and schedule the next one."""
        orders, (outputs,) = self._step(node, *node.due(at_ns, one=True))
        plan = next((message for message in outputs if isinstance(message, Plan)), None) if node.cycles else None
        delay_ns = 0 if plan is None else self._compute_delay_ns(at_ns)  # without a plan nothing was computed
        if plan is not None:
            outputs = [*outputs, timing_of(plan, at_ns, delay_ns)]
        if delay_ns:
            order = (at_ns + delay_ns, _PENDING, next(self._count), 0)
            self._schedule(order[0], _PENDING, partial(self._publish, node, [order], [outputs]))
        else:
            self._publish(node, orders, [outputs])
        if node.period_ns:
            node.next_ns = next_ns = at_ns + max(node.period_ns, delay_ns)
            self._schedule(next_ns, node.index, partial(self._step_once, node, next_ns))

    def _schedule(self, at_ns: int, index: int, act: Callable[[], None]) -> None:
        heapq.heappush(self._events, (at_ns, index, next(self._count), act))

    def _step(
        self, node: _ScheduledNode, times_ns: Sequence[int], due: Sequence[Due]
    ) -> tuple[list[EventOrder], list[list[Message]]]:
        """Take all due steps of a node; return the sort key and the outputs of each."""
        rank, numbers = node.rank, self._count
        orders = [(at_ns, rank, next(numbers), 0) for at_ns in times_ns]
        if self._log.wants_steps:
            cause: Cause = "cycle" if node.cycles else "grid"
            for number, (order, (t_ns, inbox)) in enumerate(zip(orders, due, strict=True), node.steps):
                if node.causes:
                    cause = type(inbox[-1].message)
                self._log.add(order, node.name, Step(order[0], node.name, number, t_ns, cause, inbox))
        node.steps += len(due)
        return orders, node.node.steps(due)

    def _publish(
        self, node: _ScheduledNode, orders: Sequence[EventOrder], outputs: Sequence[Sequence[Message]]
    ) -> None:
        """Assign sequence numbers to the outputs of each step and deliver them to their readers."""
        name, routes, log, transport = node.name, node.routes, self._log.add, self._transport
        for step_order, messages in zip(orders, outputs, strict=True):
            order = step_order
            for message in messages:
                kind = type(message)
                route = routes.get(kind) or self._route(node, kind)
                received = route.numbered(message, order[0])
                if route.observed:
                    log(order, name, received)
                if not route.readers:
                    continue
                if transport is not None:
                    for reader in route.readers:
                        self._carry(transport, name, reader, received, order)
                elif (reason := route.validate(message)) is None:
                    for append in route.inboxes:
                        append((order, received))
                    for reader in route.wakes:
                        self._schedule(order[0], reader.index, partial(self._step_once, reader, order[0]))
                    continue
                else:
                    self._rejections += [_Rejection(order, reader, received, reason) for reader in route.readers]
                order = (*order[:3], order[3] + 1)  # a rejection is reported before the next message

    def _route(self, node: _ScheduledNode, kind: type[Message]) -> _Route:
        """Return the route of the node's messages of one type, made at its first message."""
        if kind not in node.node.writes and kind not in _OWN:
            raise ValueError(f"{node.name} publishes {kind.__name__}, which is not among its writes")
        return node.routes.setdefault(kind, _Route(kind, self._readers.get(kind, ()), self._log.wants(kind)))

    def _carry(
        self,
        transport: Transport,
        writer: str,
        reader: _ScheduledNode,
        message: ReceivedMessage,
        order: EventOrder,
    ) -> None:
        for delivery in transport.carry(writer, reader.name, message):
            if delivery.at_ns <= message.received_t_ns:
                self._deliver(transport, reader, delivery, order)
            else:
                later = (delivery.at_ns, _PENDING, next(self._count), 0)
                self._schedule(delivery.at_ns, _PENDING, partial(self._deliver, transport, reader, delivery, later))

    def _deliver(self, transport: Transport, reader: _ScheduledNode, delivery: Delivery, order: EventOrder) -> None:
        accepted = transport.receive(reader.name, delivery)
        if isinstance(accepted, str):
            self._rejections.append(_Rejection(order, reader, delivery.message, accepted))
            return
        kind = type(accepted.message)
        received = ReceivedMessage(accepted.message, accepted.epoch, accepted.sequence, order[0])
        reader.inbox_of(kind).append((order, received))
        if kind in reader.causes:
            self._schedule(order[0], reader.index, partial(self._step_once, reader, order[0]))

    def _notify(self) -> None:
        """Report rejections to the nodes that rejected, then all events to the observers."""
        if self._rejections:
            self._report_rejections()
        self._log.notify()

    def _report_rejections(self) -> None:
        for order, reader, message, reason in sorted(self._rejections, key=_by_order):
            route = reader.routes.get(RejectedFrame) or self._route(reader, RejectedFrame)
            rejected = route.numbered(self._make_rejection(reader.name, message, reason), order[0])
            if route.observed:
                self._log.add(order, reader.name, rejected)
            if RejectedFrame in reader.node.reads:
                reader.waiting.append((order, rejected))
        self._rejections.clear()


_OWN = (CycleTiming, RejectedFrame)
"""Types that the scheduler publishes in a node's name."""


def _find_window_ends(nodes: Sequence[_ScheduledNode], *, singly: bool) -> None:
    """Mark the nodes whose every step ends a time window; the others take all steps of a window at once.

    With ``singly`` every step of every node ends a window.
    """
    read: set[type[Message]] = set()  # by nodes up to here that are no cycles
    for node in nodes:
        if not node.cycles:
            read.update(node.node.reads)
        node.ends_window = node.cycles or not read.isdisjoint(node.node.writes)
        singly |= node.ends_window and bool(node.causes)
    if singly or RejectedFrame in read:
        for node in nodes:
            node.ends_window, node.rank = True, 0  # then events are already in the order in which they happen


def timing_of(plan: Plan, start_ns: int, delay_ns: int) -> CycleTiming:
    """Return the timing of a cycle that started at ``start_ns`` and took ``delay_ns``."""
    return CycleTiming(
        t_ns=start_ns,
        compute_ns=delay_ns,
        compute_wall_ns=0,
        estimate_age_ns=start_ns - plan.estimate_t_ns,
        stage_us={},
    )
