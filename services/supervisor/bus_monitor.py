"""What the launcher hears of a run: the newest message of each key, decoded only when someone looks."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import NamedTuple, TypeVar

from ltv_mpc.messages import (
    Applied,
    Clock,
    ClockState,
    ControllerState,
    CycleTiming,
    Estimate,
    EstimatorState,
    Kill,
    Message,
    NodeStatus,
    Plan,
    RunEvent,
    Truth,
)
from services.bus.latest_cache import LatestCache
from services.bus.mailbox import Mailbox
from services.bus.roles import ROUTER
from services.bus.session import Session
from services.bus.topics import BY_TYPE, Topic
from services.bus.wire import WireError, decode, header_of, unpack
from services.runtime.clock import ClockError, VehicleClock, monotonic_us

S = TypeVar("S", bound=Message)
STATUS = BY_TYPE[NodeStatus].key

SHOWN: tuple[type[Message], ...] = (Truth, Estimate, Plan, Applied, CycleTiming, Clock)
KEPT: tuple[type[Message], ...] = (ControllerState, EstimatorState)
PLANS = 32
"""Of which one is in force: 10 s of them."""


class Activity(NamedTuple):
    """The newest thing that shows that a process does its work."""

    epoch: int  # of the process
    arrived_s: float  # monotonic


class _Plans(LatestCache):
    """Keeps some of the last plans besides."""

    def __init__(self) -> None:
        super().__init__()
        self.payloads: deque[bytes] = deque(maxlen=PLANS)

    def offer(self, topic: Topic | None, key: str, payload: bytes) -> None:
        super().offer(topic, key, payload)
        self.payloads.append(payload)


class BusMonitor:
    """The launcher's ears. ``nodes`` are the processes whose word it waits for."""

    def __init__(self, session: Session, nodes: Iterable[str]) -> None:
        self._newest = LatestCache()
        self._plans = _Plans()
        self._events = Mailbox()
        self._kills = Mailbox()
        self._clock = VehicleClock()
        for kind in (*SHOWN, *KEPT):
            session.subscribe(BY_TYPE[kind].key, BY_TYPE[kind], self._plans if kind is Plan else self._newest)
        for node in nodes:
            session.subscribe(f"{STATUS}/{node}", BY_TYPE[NodeStatus], self._newest)
        session.subscribe(f"{BY_TYPE[RunEvent].key}/*", BY_TYPE[RunEvent], self._events)
        session.subscribe(BY_TYPE[Kill].key, BY_TYPE[Kill], self._kills)

    def newest(self, kind: type[S], node: str = "") -> S | None:
        """The newest signal of this kind (of this node, where every node writes it)."""
        key = BY_TYPE[kind].key
        frame = (self._plans if kind is Plan else self._newest).get(f"{key}/{node}" if node else key)
        if frame is None:
            return None
        try:
            return decode(kind, frame.payload)[0]
        except WireError:  # its readers count it
            return None

    def plan_in_force(self) -> Plan | None:
        """The plan that the actuators have accepted last, if it was heard."""
        applied = self.newest(Applied)
        if applied is None or applied.plan_sequence < 0:
            return None
        for payload in reversed(tuple(self._plans.payloads)):
            try:
                header = header_of(unpack(payload))
                if (header.epoch, header.sequence) == (applied.plan_epoch, applied.plan_sequence):
                    return decode(Plan, payload)[0]
            except WireError:
                continue
        return None

    def running(self) -> bool:
        """Whether vehicle time goes on."""
        clock = self.newest(Clock)
        return clock is not None and clock.state is ClockState.RUNNING

    def last_activity(self, node: str) -> Activity | None:
        """What shows that ``node`` works: an estimate, a plan that the actuators have taken, for others a word; of the
        router, which says none, whatever came through it. While time stands still a word is all there is.
        """
        if node == ROUTER:
            return Activity(0, self._newest.arrived_s)
        if node == "controller" and self.running():
            applied, frame = self.newest(Applied), self._newest.get(BY_TYPE[Applied].key)
            return None if applied is None or frame is None else Activity(applied.plan_epoch, frame.arrived_s)
        works_by = BY_TYPE[Estimate].key if node == "estimator" and self.running() else f"{STATUS}/{node}"
        frame = self._newest.get(works_by)
        if frame is None:
            return None
        try:
            return Activity(header_of(unpack(frame.payload)).epoch, frame.arrived_s)
        except WireError:
            return None

    def kills(self) -> list[str]:
        """Whose process an operator wants ended, since the last call."""
        nodes = []
        while (frame := self._kills.take(0.0)) is not None:
            try:
                nodes.append(decode(Kill, frame.payload)[0].node)
            except WireError:
                continue
        return nodes

    def events(self) -> list[RunEvent]:
        """What has happened since the last call."""
        events = []
        while (frame := self._events.take(0.0)) is not None:
            try:
                events.append(decode(RunEvent, frame.payload)[0])
            except WireError:
                continue
        return events

    def t_ns(self) -> int | None:
        """Vehicle time now."""
        if (message := self.newest(Clock)) is not None:
            try:
                self._clock.follow(message)
            except ClockError:
                return None
        return self._clock.read(monotonic_us())
