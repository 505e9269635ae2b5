"""Lock step by stretches of time: what ``LockStep`` publishes, to the bit, in less than half of the time.

From the start of one cycle to that of the next, nothing that a node on a grid or on messages says comes back to it. So
each of them in turn, in the order of the list, does all its steps of that time at once (``InBulk``), with all that the
nodes before it have said by then; then the cycle is stepped. A step is given what it is given in ``LockStep``: what
has arrived before it, sorted by time, at one instant first what was on its way, then by the writer's place.

Who observes hears of every signal in order, when the stretch is over: the nodes are ahead of what they said. Whoever
looks into a node as it goes, delays messages between nodes or records steps takes ``LockStep``.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from itertools import count
from operator import itemgetter
from typing import Any, NamedTuple, Protocol, TypeAlias

from ltv_mpc.messages import Message, Plan, Rejected
from ltv_mpc.node import Arrival, Cycle, Due, Node, OnMessage, steps_of
from ltv_mpc.validation import validator
from sim.lockstep import EPOCH, LATEST, Refuse, refused_by_name, timing_of


class Listener(Protocol):
    """Hears what is said."""

    def published(self, node: str, message: Arrival) -> None:
        """``node`` published this at ``message.received_t_ns``; its sequence counts by type from 0."""
        ...


Place: TypeAlias = tuple[int, int, int]
"""In the order of all that happens: time, place of who spoke in the list of nodes (-1: on its way before), a count."""

_ON_ITS_WAY = -1

_by_place = itemgetter(0)


class _Refusal(NamedTuple):
    """What ``validation`` refuses one reader."""

    place: Place
    reader: _Seat
    message: Arrival
    reason: str


class _Route:
    """Where one node's signals of one type go. Looked up once for each, not a thing at a time."""

    __slots__ = ("_published", "judge", "readers", "told")

    def __init__(self, kind: type[Message], readers: Sequence[_Seat], told: bool) -> None:
        self.judge = validator(kind)
        self.readers = tuple(readers)
        self.told = told
        self._published = 0

    def numbered(self, signal: Message, at_ns: int) -> Arrival:
        """The next of them, as it is published."""
        number = self._published
        self._published = number + 1
        return Arrival(signal, EPOCH, number, at_ns)


class _Seat:
    """A node's place at the table: what has been said to it, and when it is due."""

    def __init__(self, index: int, node: Node, start_ns: int) -> None:
        self.index, self.name, self.node = index, node.name, node
        schedule = node.schedule
        self.causes = frozenset(schedule.types if isinstance(schedule, OnMessage) else ())
        self.period_ns = 0 if isinstance(schedule, OnMessage) else schedule.period_ns
        self.next_ns = -(-start_ns // self.period_ns) * self.period_ns if self.period_ns else 0
        self.steps = steps_of(node)
        self.heard: list[tuple[Place, Arrival]] = []  # and not handed on yet
        self.routes: dict[type[Message], _Route] = {}

    def due(self, end_ns: int) -> tuple[list[int], list[Due]]:
        """When, and what for, it is to be stepped up to ``end_ns``."""
        return self._on_message(end_ns) if self.causes else self._on_grid(end_ns)

    def take(self, before: Place) -> list[Arrival]:
        """What it has heard before."""
        heard = self.heard
        if not heard:
            return []
        heard.sort(key=_by_place)
        number = bisect_left(heard, before, key=_by_place)
        inbox = [message for _, message in heard[:number]]
        del heard[:number]
        return inbox

    def _on_grid(self, end_ns: int) -> tuple[list[int], list[Due]]:
        times = list(range(self.next_ns, end_ns + 1, self.period_ns))
        if times:
            self.next_ns = times[-1] + self.period_ns
        return times, [(t_ns, self.take((t_ns, self.index, 0)) if self.heard else []) for t_ns in times]

    def _on_message(self, end_ns: int) -> tuple[list[int], list[Due]]:
        heard, causes = self.heard, self.causes
        heard.sort(key=_by_place)
        if not causes.issuperset([type(message.signal) for _, message in heard]):
            # At one instant what causes no step comes first.
            heard.sort(key=lambda x: (x[0][0], type(x[1].signal) in causes))
        times: list[int] = []
        due: list[Due] = []
        inbox: list[Arrival] = []
        taken = 0
        for number, ((at_ns, _, _), message) in enumerate(heard, 1):
            if at_ns > end_ns:
                break
            inbox.append(message)
            signal: Any = message.signal  # a type that causes steps has its validity time
            if type(signal) in causes:
                times.append(at_ns)
                due.append((signal.t_ns, inbox))
                inbox, taken = [], number
        del heard[:taken]
        return times, due


class Stretches:
    """The nodes of one run from ``start_ns`` on, as in ``LockStep``, with the same meaning of every argument.

    ``heard`` are the types of which ``observe`` is told, None for all; signals of others are counted in ``untold``.

    Raises ``ValueError`` where a node on a grid or on messages reads what itself or one after it in the list writes, is
    told of refused messages, or wants the newest only; or where one stands after a node that cycles.
    """

    def __init__(
        self,
        nodes: Sequence[Node],
        *,
        start_ns: int,
        compute_delay_ns: int = 0,
        observe: Listener | None = None,
        heard: frozenset[type[Message]] | None = None,
        latest: frozenset[type[Message]] = LATEST,
        refused: Refuse = refused_by_name,
    ) -> None:
        self._delay_ns = compute_delay_ns
        self._observe = observe
        self._heard = heard
        self.untold = 0
        self._latest = latest
        self._refused = refused
        seats = [_Seat(index, node, start_ns) for index, node in enumerate(nodes)]
        self._flowing = [seat for seat in seats if not isinstance(seat.node.schedule, Cycle)]
        self._cycling = [seat for seat in seats if isinstance(seat.node.schedule, Cycle)]
        if seats != self._flowing + self._cycling:
            raise ValueError("nodes that cycle come last")
        self._readers: dict[type[Message], list[_Seat]] = {}
        for seat in seats:
            for kind in seat.node.reads:
                self._readers.setdefault(kind, []).append(seat)
        for seat in self._flowing:
            later = {kind for other in self._flowing[seat.index :] for kind in other.node.writes}
            if unfit := (later | {Rejected} | latest - seat.causes).intersection(seat.node.reads):
                raise ValueError(f"{seat.name} reads {', '.join(sorted(kind.__name__ for kind in unfit))}")
        self._count = count()
        self._said: list[tuple[Place, str, Arrival]] = []
        self._refusals: list[_Refusal] = []

    def advance(self, until_ns: int) -> None:
        """Every step up to and including ``until_ns``."""
        while True:
            cycle = min(self._cycling, key=lambda seat: (seat.next_ns, seat.index), default=None)
            is_due = cycle is not None and cycle.next_ns <= until_ns
            end_ns = cycle.next_ns if cycle is not None and is_due else until_ns
            for seat in self._flowing:
                times, due = seat.due(end_ns)
                if due:
                    self._publish(seat, times, seat.steps(due), seat.index)
            if cycle is not None and is_due:
                self._tell((end_ns, cycle.index, 0))
                self._cycle(cycle)
            else:
                self._tell((end_ns + 1, _ON_ITS_WAY, 0))
                return

    def _cycle(self, seat: _Seat) -> None:
        at_ns = seat.next_ns
        inbox = seat.take((at_ns, seat.index, 0))
        if not self._latest.isdisjoint(seat.node.reads):
            newest = {type(message.signal): message for message in inbox}
            inbox = [m for m in inbox if type(m.signal) not in self._latest or newest[type(m.signal)] is m]
        outputs = seat.node.step(at_ns, inbox)
        plan = next((signal for signal in outputs if isinstance(signal, Plan)), None)
        delay_ns = 0 if plan is None else self._delay_ns  # without a plan nothing was computed
        if plan is not None:
            outputs = [*outputs, timing_of(plan, at_ns, delay_ns)]
        self._publish(seat, [at_ns + delay_ns], [outputs], _ON_ITS_WAY if delay_ns else seat.index)
        seat.next_ns = at_ns + max(seat.period_ns, delay_ns)

    def _publish(self, seat: _Seat, times_ns: Sequence[int], outputs: Sequence[Sequence[Message]], index: int) -> None:
        name, routes, said, numbers = seat.name, seat.routes, self._said.append, self._count
        on_its_way = index == _ON_ITS_WAY  # what is may never be told
        for at_ns, signals in zip(times_ns, outputs, strict=True):
            for signal in signals:
                kind = type(signal)
                route = routes.get(kind) or self._route(seat, kind)
                place, message = (at_ns, index, next(numbers)), route.numbered(signal, at_ns)
                if route.told or on_its_way:
                    said((place, name, message))
                else:
                    self.untold += 1
                if not route.readers:
                    continue
                reason = route.judge(signal)
                for reader in route.readers:
                    if reason is None:
                        reader.heard.append((place, message))
                    else:
                        self._refusals.append(_Refusal(place, reader, message, reason))

    def _route(self, seat: _Seat, kind: type[Message]) -> _Route:
        """Of ``kind`` from this seat."""
        told = self._heard is None or kind in self._heard
        return seat.routes.setdefault(kind, _Route(kind, self._readers.get(kind, ()), told))

    def _tell(self, before: Place) -> None:
        """Who observes of all that was said before; whose messages were refused, of that."""
        if self._refusals:
            self._turn_back(before)
        said = self._said
        said.sort(key=_by_place)
        number = bisect_left(said, before, key=_by_place)
        if self._observe is not None:
            published = self._observe.published
            for _, name, message in said[:number]:
                published(name, message)
        del said[:number]

    def _turn_back(self, before: Place) -> None:
        refusals, self._refusals = sorted(self._refusals, key=_by_place), []
        for refused in refusals:
            if refused.place >= before:
                self._refusals.append(refused)
                continue
            place, reader, at_ns = refused.place, refused.reader, refused.place[0]
            rejected = self._refused(reader.name, refused.message, refused.reason)
            told = self._route(reader, Rejected).numbered(rejected, at_ns)
            self._said.append((place, reader.name, told))
            if Rejected in reader.node.reads:
                reader.heard.append((place, told))
