"""Lock step: all nodes in one process on a simulated clock. The same nodes and the same seed give the same bits.

At one instant deliveries that were on their way come first, then steps in the order of the list of nodes: plant,
sensors, estimator, controller. A message is handed at once to every node that reads its type, with two exceptions:

- what a ``Cycle`` node writes arrives ``compute_delay_ns`` after the start of its cycle, exactly; until then the cycle
  is in flight and the next one waits (one solve at a time). With no delay the plan arrives at the same instant, when
  the plant, first in the list, has already stepped: it acts on the plan in its next step;
- of a type in ``latest`` an inbox holds the newest only.

The scheduler works by stretches of time (conservative lookahead). A stretch ends at the next instant at which a node
could read something that a node at its own place or after it in the list writes: at the next cycle, at the next step
of a node on a grid that writes such a type, or when something that is on its way arrives. Until then each node in turn
does all its steps in one call of ``steps``, with all that the nodes before it have published by then. Where a node on
messages writes such a type, where a node other than a cycle is told of refused messages, or where ``between`` carries
the messages, a stretch is one step. How long stretches are changes the speed of a run and nothing else.

Observers are told at the end of each stretch, in the order in which things happened. A node may then be ahead of what
is told: whoever looks into a node as it goes wraps it in a node of his own, which takes the steps one at a time.

Whoever calls a cycle measures it. Here nothing is measured: a cycle that made a plan is followed by a ``CycleTiming``
that says ``compute_delay_ns``, no wall time and no stages.
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
"""The epoch of every node: in lock step none restarts."""

LATEST: frozenset[type[Message]] = frozenset({Estimate})
"""Types of which a reader wants the newest value only."""

Cause: TypeAlias = str | type[Message]
"""``"grid"``, ``"cycle"`` or the type of the message that caused a step."""

Refuse: TypeAlias = Callable[[str, ReceivedMessage, str], RejectedFrame]
"""Node, what arrived, reason -> the message that says so."""


class Step(NamedTuple):
    """Step ``number`` of ``node`` (from 0) for ``t_ns`` took this inbox when the clock stood at ``at_ns``."""

    at_ns: int
    node: str
    number: int
    t_ns: int
    cause: Cause
    inbox: Inbox


class Observer(Protocol):
    """Is told of messages in the order of their publication."""

    def published(self, node: str, message: ReceivedMessage) -> None:
        """``node`` published this at ``message.received_t_ns``; its sequence counts by type from 0."""
        ...


class Delivery(NamedTuple):
    """A copy of a message on its way to one reader. ``payload``: these bytes arrive in the message's place."""

    at_ns: int
    message: ReceivedMessage
    payload: bytes | None = None


class Between(Protocol):
    """Carries every message to each of its readers and checks it there: it stands where the bus is between processes.

    Without one a message arrives as it was published, and validation alone checks it.
    """

    def carry(self, writer: str, reader: str, message: ReceivedMessage) -> Sequence[Delivery]:
        """What comes of a message published at ``message.received_t_ns``, and when; nothing: it is lost."""
        ...

    def receive(self, reader: str, delivery: Delivery) -> ReceivedMessage | str:
        """What the reader's door lets in, or why not."""
        ...


def rejected_by_type_name(node: str, message: ReceivedMessage, reason: str) -> RejectedFrame:
    """What a node is told of a refused message where no wire has given it a key, a crc and a payload."""
    kind = type(message.message).__name__
    return RejectedFrame(t_ns=message.received_t_ns, node=node, key=kind, reason=reason, crc=0, payload_base64="")


Place: TypeAlias = tuple[int, int, int, int]
"""In the order of all that happens: time, place of the node in the list (-1: it was on its way before), a count of
steps, and of the messages of that step that were refused. What has one place is kept in the order of publication."""

_ON_ITS_WAY = -1

_by_place = itemgetter(0)


class _Refusal(NamedTuple):
    """A message that one reader does not get."""

    place: Place
    reader: _Seat
    message: ReceivedMessage
    reason: str


class _Route:
    """Where one node's messages of one type go. Looked up once for each type."""

    __slots__ = ("inboxes", "judge", "published", "readers", "told", "wakes")

    def __init__(self, kind: type[Message], readers: Sequence[_Seat], told: bool) -> None:
        self.judge = validator(kind)
        self.readers = tuple(readers)
        self.inboxes = tuple(reader.inbox_of(kind).append for reader in readers)
        self.wakes = tuple(reader for reader in readers if reader.bounds and kind in reader.causes)
        self.told = told
        self.published = 0

    def numbered(self, signal: Message, at_ns: int) -> ReceivedMessage:
        """The next of them, as it is published."""
        number = self.published
        self.published = number + 1
        return ReceivedMessage(signal, EPOCH, number, at_ns)


class _Seat:
    """A node with what has been published to it, and when it is due."""

    def __init__(self, index: int, node: Node, start_ns: int, latest: frozenset[type[Message]]) -> None:
        self.index, self.name, self.node = index, node.name, node
        self.rank = index  # of what it publishes, among all that is published at one instant
        self.bounds = False  # whether each of its steps ends a stretch
        schedule = node.schedule
        self.cycles = isinstance(schedule, Cycle)
        self.causes = frozenset(schedule.types if isinstance(schedule, OnMessage) else ())
        self.period_ns = 0 if isinstance(schedule, OnMessage) else schedule.period_ns
        # On the grid k x period, not before the start.
        self.next_ns = -(-start_ns // self.period_ns) * self.period_ns if self.period_ns else 0
        self._latest = latest.intersection(node.reads) - self.causes
        self.waiting: list[tuple[Place, ReceivedMessage]] = []
        self.causing: list[tuple[Place, ReceivedMessage]] = []
        self.routes: dict[type[Message], _Route] = {}
        self.steps = 0

    def inbox_of(self, kind: type[Message]) -> list[tuple[Place, ReceivedMessage]]:
        """Where a message of this type goes: it causes a step, or waits for the next one."""
        return self.causing if kind in self.causes else self.waiting

    def due(self, last_ns: int, *, one: bool = False) -> tuple[list[int], list[Due]]:
        """When, and what for, it is to be stepped up to ``last_ns``; ``one``: the first of them alone."""
        return self._by_time(last_ns) if self.period_ns else self._by_messages(last_ns, one=one)

    def _by_time(self, last_ns: int) -> tuple[list[int], list[Due]]:
        times = list(range(self.next_ns, last_ns + 1, self.period_ns))
        if times:
            self.next_ns = times[-1] + self.period_ns
        return times, [(t_ns, self._take(t_ns) if self.waiting else []) for t_ns in times]

    def _by_messages(self, last_ns: int, *, one: bool) -> tuple[list[int], list[Due]]:
        causing = self.causing
        causing.sort(key=_by_place)
        number = 1 if one else bisect_right(causing, last_ns, key=_time_of)
        times: list[int] = []
        due: list[Due] = []
        for (at_ns, *_), message in causing[:number]:
            signal: Any = message.message  # a type that causes steps has its validity time
            times.append(at_ns)
            due.append((signal.t_ns, [*self._take(at_ns), message] if self.waiting else [message]))
        del causing[:number]
        return times, due

    def _take(self, at_ns: int) -> list[ReceivedMessage]:
        """What has arrived by then; what comes at that instant from later in the list is not published yet."""
        waiting = self.waiting
        waiting.sort(key=_by_place)
        number = bisect_right(waiting, at_ns, key=_time_of)
        inbox = [message for _, message in waiting[:number]]
        del waiting[:number]
        if not self._latest:
            return inbox
        newest = {type(message.message): message for message in inbox}
        return [m for m in inbox if type(m.message) not in self._latest or newest[type(m.message)] is m]


def _time_of(entry: tuple[Place, ReceivedMessage]) -> int:
    return entry[0][0]


class LockStep:
    """The nodes of one run between ``start_ns`` and wherever ``advance`` has taken it.

    ``compute_delay_ns`` is one for all cycles, or a function of a cycle's start. ``observe`` is told of each message,
    or of those of the types ``heard``; ``stepped`` is told of each step, before its messages. ``latest`` names the
    types of which a reader wants the newest only, ``refused`` words the ``RejectedFrame`` for what is turned away.
    """

    def __init__(
        self,
        nodes: Sequence[Node],
        *,
        start_ns: int,
        compute_delay_ns: int | Callable[[int], int] = 0,
        observe: Observer | None = None,
        heard: frozenset[type[Message]] | None = None,
        stepped: Callable[[Step], None] | None = None,
        latest: frozenset[type[Message]] = LATEST,
        refused: Refuse = rejected_by_type_name,
        between: Between | None = None,
    ) -> None:
        self._compute_delay_ns = compute_delay_ns if callable(compute_delay_ns) else lambda _: compute_delay_ns
        self._observe = observe
        self._heard = frozenset[type[Message]]() if observe is None else heard
        self._stepped = stepped
        self._refused = refused
        self._between = between
        self._seats = [_Seat(index, node, start_ns, latest) for index, node in enumerate(nodes)]
        _divide(self._seats, singly=between is not None)
        self._flowing = [seat for seat in self._seats if not seat.bounds]
        self._readers: dict[type[Message], list[_Seat]] = {}
        for seat in self._seats:
            for kind in seat.node.reads:
                self._readers.setdefault(kind, []).append(seat)
        self._count = count()
        # A heap of what ends stretches: time, place in the list, a count, and what happens then.
        self._events: list[tuple[int, int, int, Callable[[], None]]] = []
        for seat in self._seats:
            if seat.bounds and seat.period_ns:
                self._later(seat.next_ns, seat.index, partial(self._once, seat, seat.next_ns))
        self._happened: list[tuple[Place, str, Step | ReceivedMessage]] = []  # and not told yet
        self._refusals: list[_Refusal] = []

    @property
    def steps(self) -> dict[str, int]:
        """Steps done so far by each node."""
        return {seat.name: seat.steps for seat in self._seats}

    @property
    def published(self) -> int:
        """Messages published so far, by all nodes."""
        return sum(route.published for seat in self._seats for route in seat.routes.values())

    def advance(self, until_ns: int) -> None:
        """Everything that happens up to and including ``until_ns``."""
        try:
            while self._stretch(until_ns):
                pass
        finally:
            self._tell()

    def _stretch(self, until_ns: int) -> bool:
        """Go on to the next event that ends a stretch, and let it happen; False where none is left."""
        events = self._events
        event = heapq.heappop(events) if events and events[0][0] <= until_ns else None
        end_ns, index = (until_ns + 1, _ON_ITS_WAY) if event is None else event[:2]
        for seat in self._flowing:
            times_ns, due = seat.due(end_ns if seat.index < index else end_ns - 1)
            if due:
                self._publish(seat, *self._step(seat, times_ns, due))
        self._tell()
        if event is not None:
            event[-1]()
        return event is not None

    def _once(self, seat: _Seat, at_ns: int) -> None:
        places, (outputs,) = self._step(seat, *seat.due(at_ns, one=True))
        plan = next((signal for signal in outputs if isinstance(signal, Plan)), None) if seat.cycles else None
        delay_ns = 0 if plan is None else self._compute_delay_ns(at_ns)  # without a plan nothing was computed
        if plan is not None:
            outputs = [*outputs, timing_of(plan, at_ns, delay_ns)]
        if delay_ns:
            place = (at_ns + delay_ns, _ON_ITS_WAY, next(self._count), 0)
            self._later(place[0], _ON_ITS_WAY, partial(self._publish, seat, [place], [outputs]))
        else:
            self._publish(seat, places, [outputs])
        if seat.period_ns:
            seat.next_ns = next_ns = at_ns + max(seat.period_ns, delay_ns)
            self._later(next_ns, seat.index, partial(self._once, seat, next_ns))

    def _later(self, at_ns: int, index: int, act: Callable[[], None]) -> None:
        heapq.heappush(self._events, (at_ns, index, next(self._count), act))

    def _step(
        self, seat: _Seat, times_ns: Sequence[int], due: Sequence[Due]
    ) -> tuple[list[Place], list[list[Message]]]:
        rank, numbers = seat.rank, self._count
        places = [(at_ns, rank, next(numbers), 0) for at_ns in times_ns]
        if self._stepped is not None:
            cause: Cause = "cycle" if seat.cycles else "grid"
            for number, (place, (t_ns, inbox)) in enumerate(zip(places, due, strict=True), seat.steps):
                if seat.causes:
                    cause = type(inbox[-1].message)
                self._happened.append((place, seat.name, Step(place[0], seat.name, number, t_ns, cause, inbox)))
        seat.steps += len(due)
        return places, seat.node.steps(due)

    def _publish(self, seat: _Seat, places: Sequence[Place], outputs: Sequence[Sequence[Message]]) -> None:
        name, routes, happened, between = seat.name, seat.routes, self._happened.append, self._between
        for place, signals in zip(places, outputs, strict=True):
            for signal in signals:
                kind = type(signal)
                route = routes.get(kind) or self._route(seat, kind)
                message = route.numbered(signal, place[0])
                if route.told:
                    happened((place, name, message))
                if not route.readers:
                    continue
                if between is not None:
                    for reader in route.readers:
                        self._carry(between, name, reader, message, place)
                elif (reason := route.judge(signal)) is None:
                    for append in route.inboxes:
                        append((place, message))
                    for reader in route.wakes:
                        self._later(place[0], reader.index, partial(self._once, reader, place[0]))
                    continue
                else:
                    self._refusals += [_Refusal(place, reader, message, reason) for reader in route.readers]
                place = (*place[:3], place[3] + 1)  # a refusal is told before the next message

    def _route(self, seat: _Seat, kind: type[Message]) -> _Route:
        """Of ``kind`` from this seat."""
        if kind not in seat.node.writes and kind not in _OWN:
            raise ValueError(f"{seat.name} publishes {kind.__name__}, which is not among its writes")
        told = self._heard is None or kind in self._heard
        return seat.routes.setdefault(kind, _Route(kind, self._readers.get(kind, ()), told))

    def _carry(self, between: Between, writer: str, reader: _Seat, message: ReceivedMessage, place: Place) -> None:
        for delivery in between.carry(writer, reader.name, message):
            if delivery.at_ns <= message.received_t_ns:
                self._arrive(between, reader, delivery, place)
            else:
                later = (delivery.at_ns, _ON_ITS_WAY, next(self._count), 0)
                self._later(delivery.at_ns, _ON_ITS_WAY, partial(self._arrive, between, reader, delivery, later))

    def _arrive(self, between: Between, reader: _Seat, delivery: Delivery, place: Place) -> None:
        admitted = between.receive(reader.name, delivery)
        if isinstance(admitted, str):
            self._refusals.append(_Refusal(place, reader, delivery.message, admitted))
        else:
            message, kind = (
                ReceivedMessage(admitted.message, admitted.epoch, admitted.sequence, place[0]),
                type(admitted.message),
            )
            reader.inbox_of(kind).append((place, message))
            if kind in reader.causes:
                self._later(place[0], reader.index, partial(self._once, reader, place[0]))

    def _tell(self) -> None:
        """Those whose messages were refused, then the observers, of all that has happened."""
        if self._refusals:
            self._turn_back()
        happened, self._happened = self._happened, []
        happened.sort(key=_by_place)
        for _, name, what in happened:
            if type(what) is Step:
                assert self._stepped is not None
                self._stepped(what)
            elif self._observe is not None:
                self._observe.published(name, what)  # type: ignore[arg-type]

    def _turn_back(self) -> None:
        for place, reader, message, reason in sorted(self._refusals, key=_by_place):
            route = reader.routes.get(RejectedFrame) or self._route(reader, RejectedFrame)
            rejected = route.numbered(self._refused(reader.name, message, reason), place[0])
            if route.told:
                self._happened.append((place, reader.name, rejected))
            if RejectedFrame in reader.node.reads:
                reader.waiting.append((place, rejected))
        self._refusals.clear()


_OWN = (CycleTiming, RejectedFrame)
"""Types that the scheduler publishes in a node's name."""


def _divide(seats: Sequence[_Seat], *, singly: bool) -> None:
    """Find the nodes whose every step ends a stretch; the others do all steps of a stretch at once."""
    read: set[type[Message]] = set()  # by nodes up to here that do not cycle
    for seat in seats:
        if not seat.cycles:
            read.update(seat.node.reads)
        seat.bounds = seat.cycles or not read.isdisjoint(seat.node.writes)
        singly |= seat.bounds and bool(seat.causes)
    if singly or RejectedFrame in read:
        for seat in seats:
            seat.bounds, seat.rank = True, 0  # things are in the order in which they happen


def timing_of(plan: Plan, start_ns: int, delay_ns: int) -> CycleTiming:
    """What a cycle from ``start_ns`` is said to have cost."""
    return CycleTiming(
        t_ns=start_ns,
        compute_ns=delay_ns,
        compute_wall_ns=0,
        estimate_age_ns=start_ns - plan.estimate_t_ns,
        stage_us={},
    )
