"""Lock step: all nodes of a run in one process on a simulated clock. One seed gives the same bits in every run.

At one instant pending deliveries come first, then steps in the order of the list of nodes: plant, sensors, estimator,
controller. A message is delivered at once to every node that reads its type, but the output of a ``Cycle`` node arrives
exactly ``compute_delay_ns`` after the start of its cycle. Until then the cycle is in flight and the next one waits:
there is one solve at a time. Without delay the plan arrives at the same instant. The plant, first in the list, has then
already stepped, so it acts on the plan in its next step.

The caller of a cycle measures it. Here nothing is measured: a cycle that made a plan is followed by a ``CycleTiming``
with ``compute_delay_ns``, no wall time and no stages.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Sequence
from functools import partial
from itertools import count
from typing import Any, NamedTuple, Protocol, TypeAlias

from ltv_mpc.messages import CycleTiming, Message, Plan, RejectedFrame
from ltv_mpc.node import Cycle, Inbox, Node, OnMessage, ReceivedMessage
from ltv_mpc.validation import Validator, validator

EPOCH = 1
"""Epoch of every node: in lock step no node restarts."""

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


def rejected_by_type_name(node: str, message: ReceivedMessage, reason: str) -> RejectedFrame:
    """Return the rejection of a message that has no frame: its type for the key, and neither crc nor payload."""
    kind = type(message.message).__name__
    return RejectedFrame(t_ns=message.received_t_ns, node=node, key=kind, reason=reason, crc=0, payload_base64="")


PENDING = -1
"""Place of a pending delivery: before the steps of its instant."""


class _Route(NamedTuple):
    """Readers of one node's messages of one type, looked up once for each type."""

    validate: Validator
    readers: tuple[_ScheduledNode, ...]
    observer: Observer | None  # None: it is not notified of this type
    numbers: count[int]

    def numbered(self, message: Message, at_ns: int) -> ReceivedMessage:
        """Return the message with the next sequence number."""
        return ReceivedMessage(message, EPOCH, next(self.numbers), at_ns)


class _ScheduledNode:
    """Node with the messages that wait for its next step."""

    def __init__(self, index: int, node: Node) -> None:
        self.index, self.name, self.step = index, node.name, node.step
        self.reads, self.writes = frozenset(node.reads), frozenset((*node.writes, *_OWN))
        schedule = node.schedule
        self.cycles = isinstance(schedule, Cycle)
        self.causes = frozenset(schedule.types if isinstance(schedule, OnMessage) else ())
        self.period_ns = 0 if isinstance(schedule, OnMessage) else schedule.period_ns
        self._waiting: list[ReceivedMessage] = []
        self.routes: dict[type[Message], _Route] = {}
        self.steps = 0

    def receive(self, received: ReceivedMessage) -> None:
        """Put a message into the inbox of the next step."""
        self._waiting.append(received)

    def take(self) -> list[ReceivedMessage]:
        """Empty the inbox for a step."""
        inbox, self._waiting = self._waiting, []
        return inbox


class LockStep:
    """Lock step of the nodes of one run, from ``start_ns`` to the time that ``advance`` has reached."""

    def __init__(
        self,
        nodes: Sequence[Node],
        *,
        start_ns: int,
        compute_delay_ns: int | Callable[[int], int] = 0,
        observation: Observation = NO_OBSERVATION,
        make_rejection: MakeRejection = rejected_by_type_name,
    ) -> None:
        """Schedule the nodes.

        Parameters
        ----------
        nodes : nodes in the order in which they step at one instant.
        start_ns : vehicle time of the start (ns).
        compute_delay_ns : delay of a cycle's output (ns): one for all cycles, or a function of a cycle's start.
        observation : observer of messages and steps.
        make_rejection : returns the message that reports a rejected one.
        """
        self._compute_delay_ns = compute_delay_ns if callable(compute_delay_ns) else lambda _: compute_delay_ns
        self._observer, self._types, self._on_step = observation
        self._make_rejection = make_rejection
        self.published = 0
        """Number of messages of all nodes so far."""
        self._count = count()
        # Heap of what happens next: time, place in the list, a count, and the action.
        self._events: list[tuple[int, int, int, Callable[[], None]]] = []
        self._nodes = [_ScheduledNode(index, node) for index, node in enumerate(nodes)]
        for node in self._nodes:
            if node.period_ns:  # on the grid k x period, not before the start
                self._schedule_step(node, -(-start_ns // node.period_ns) * node.period_ns)

    @property
    def steps(self) -> dict[str, int]:
        """Number of steps of each node so far."""
        return {node.name: node.steps for node in self._nodes}

    def advance(self, until_ns: int) -> None:
        """Simulate all events up to and including ``until_ns``."""
        events = self._events
        while events and events[0][0] <= until_ns:
            heapq.heappop(events)[-1]()

    def _schedule(self, at_ns: int, index: int, act: Callable[[], None]) -> None:
        heapq.heappush(self._events, (at_ns, index, next(self._count), act))

    def _schedule_step(self, node: _ScheduledNode, at_ns: int) -> None:
        self._schedule(at_ns, node.index, partial(self._step_by_time, node, at_ns))

    def _step_by_time(self, node: _ScheduledNode, at_ns: int) -> None:
        """Take the step of a grid or a cycle, and schedule the next one."""
        outputs = self._step(node, at_ns, at_ns, "cycle" if node.cycles else "grid", node.take())
        plan = next((message for message in outputs if isinstance(message, Plan)), None) if node.cycles else None
        delay_ns = 0 if plan is None else self._compute_delay_ns(at_ns)  # without a plan nothing was computed
        if plan is not None:
            outputs = [*outputs, timing_of(plan, at_ns, delay_ns)]
        if delay_ns:
            arrival_ns = at_ns + delay_ns
            self._schedule(arrival_ns, PENDING, partial(self._publish, node, arrival_ns, outputs))
        else:
            self._publish(node, at_ns, outputs)
        self._schedule_step(node, at_ns + max(node.period_ns, delay_ns))

    def _step_by_message(self, node: _ScheduledNode, received: ReceivedMessage) -> None:
        """Take the step that a message causes, with what has arrived before its turn."""
        message: Any = received.message  # a type that causes steps has its validity time
        at_ns = received.received_t_ns
        self._publish(node, at_ns, self._step(node, at_ns, message.t_ns, type(message), [*node.take(), received]))

    def _step(self, node: _ScheduledNode, at_ns: int, t_ns: int, cause: Cause, inbox: Inbox) -> Sequence[Message]:
        if self._on_step is not None:
            self._on_step(Step(at_ns, node.name, node.steps, t_ns, cause, inbox))
        node.steps += 1
        return node.step(t_ns, inbox)

    def _publish(self, node: _ScheduledNode, at_ns: int, messages: Sequence[Message]) -> None:
        """Deliver the outputs of a step to their readers."""
        for message in messages:
            route, received = self._announce(node, message, at_ns)
            if route.readers:
                self._carry(node.name, route, received)

    def _carry(self, writer: str, route: _Route, received: ReceivedMessage) -> None:  # noqa: ARG002  (faults need it)
        """Deliver a message as published to its readers, which reject it if it is not valid."""
        reason = route.validate(received.message)
        for reader in route.readers:
            if reason is None:
                self._deliver(reader, received)
            else:
                self._reject(reader, received, reason, received.received_t_ns)

    def _announce(self, node: _ScheduledNode, message: Message, at_ns: int) -> tuple[_Route, ReceivedMessage]:
        """Give a message its number, and tell the observer."""
        kind = type(message)
        route = node.routes.get(kind)
        if route is None:
            if kind not in node.writes:
                raise ValueError(f"{node.name} publishes {kind.__name__}, which is not among its writes")
            readers = tuple(reader for reader in self._nodes if kind in reader.reads)
            observed = self._types is None or kind in self._types
            route = node.routes[kind] = _Route(validator(kind), readers, self._observer if observed else None, count())
        received = route.numbered(message, at_ns)
        self.published += 1
        if route.observer is not None:
            route.observer.published(node.name, received)
        return route, received

    def _deliver(self, reader: _ScheduledNode, received: ReceivedMessage) -> None:
        if type(received.message) in reader.causes:
            step = partial(self._step_by_message, reader, received)
            self._schedule(received.received_t_ns, reader.index, step)
        else:
            reader.receive(received)

    def _reject(self, reader: _ScheduledNode, message: ReceivedMessage, reason: str, at_ns: int) -> None:
        """Publish the rejection in the reader's name."""
        self._announce(reader, self._make_rejection(reader.name, message, reason), at_ns)


_OWN = (CycleTiming, RejectedFrame)
"""Types that the scheduler publishes in a node's name."""


def timing_of(plan: Plan, start_ns: int, delay_ns: int) -> CycleTiming:
    """Return the timing of a cycle that started at ``start_ns`` and took ``delay_ns``."""
    return CycleTiming(
        t_ns=start_ns,
        compute_ns=delay_ns,
        compute_wall_ns=0,
        estimate_age_ns=start_ns - plan.estimate_t_ns,
        stage_us={},
    )
