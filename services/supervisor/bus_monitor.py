"""Bus monitor of the supervisor: the newest message of each key, decoded once, when it is first read."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import NamedTuple, TypeVar, cast

from ltv_mpc.messages import (
    Applied,
    Clock,
    ClockState,
    ControllerState,
    ControllerStatus,
    CycleTiming,
    Estimate,
    EstimatorState,
    Kill,
    LocalisationReport,
    Message,
    NodeStatus,
    Plan,
    RunEvent,
    Truth,
)
from services.bus.latest_cache import LatestCache
from services.bus.mailbox import Mailbox
from services.bus.message_validation import message_at
from services.bus.roles import ROUTER
from services.bus.session import Session
from services.bus.topics import BY_TYPE, Topic, expression
from services.bus.wire import WireError, decode, header_of, unpack
from services.runtime.clock import ClockError, VehicleClock, monotonic_us

S = TypeVar("S", bound=Message)
STATUS = BY_TYPE[NodeStatus].key

DISPLAYED: tuple[type[Message], ...] = (
    *(Truth, Estimate, LocalisationReport, Plan, Applied, ControllerStatus, CycleTiming, Clock),
)
RESTORED: tuple[type[Message], ...] = (ControllerState, EstimatorState)
PLAN_HISTORY = 32
"""Plans that are kept, 10 s of them: one of them is in force at the actuators."""


class Activity(NamedTuple):
    """Newest message that shows that a process does its work."""

    epoch: int  # of the process; 0 for the router, which has none
    arrived_s: float  # monotonic time


class _RecentPlans(LatestCache):
    """Cache of the newest plan that also keeps the last ``PLAN_HISTORY`` plans."""

    def __init__(self) -> None:
        super().__init__()
        self.payloads: deque[bytes] = deque(maxlen=PLAN_HISTORY)

    def offer(self, topic: Topic | None, key: str, payload: bytes) -> None:
        super().offer(topic, key, payload)
        self.payloads.append(payload)


class BusMonitor:
    """Subscriptions of the supervisor. ``nodes`` are the processes whose status it reads; ``*`` reads all."""

    def __init__(self, session: Session, nodes: Iterable[str]) -> None:
        self._newest = LatestCache()
        self._plans = _RecentPlans()
        self._events = Mailbox()
        self._kills = Mailbox()
        self._clock = VehicleClock()
        self._decoded: dict[str, tuple[bytes, Message | None]] = {}  # by key: the payload, and its message
        for kind in (*DISPLAYED, *RESTORED):
            session.subscribe(expression(BY_TYPE[kind]), BY_TYPE[kind], self._plans if kind is Plan else self._newest)
        for node in nodes:
            session.subscribe(f"{STATUS}/{node}", BY_TYPE[NodeStatus], self._newest)
        session.subscribe(f"{BY_TYPE[RunEvent].key}/*", BY_TYPE[RunEvent], self._events)
        session.subscribe(BY_TYPE[Kill].key, BY_TYPE[Kill], self._kills)

    def newest(self, kind: type[S], node: str = "") -> S | None:
        """Return the newest message of this type, or None.

        ``node`` is the last part of its key: the process if every process writes it, the source of an estimate.
        """
        key = BY_TYPE[kind].key
        frame_key = f"{key}/{node}" if node else key
        frame = (self._plans if kind is Plan else self._newest).get(frame_key)
        if frame is None:
            return None
        payload, message = self._decoded.get(frame_key, (b"", None))
        if payload is not frame.payload:
            try:
                message = message_at(frame.topic, frame_key, unpack(frame.payload))[0]
            except WireError:  # counted by the processes that read it
                message = None
            self._decoded[frame_key] = frame.payload, message
        return message if isinstance(message, kind) else None

    def plan_in_force(self) -> Plan | None:
        """Return the plan that the actuators have accepted last; None if it has not been received."""
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

    def nodes(self) -> list[str]:
        """Return the processes that have published a status."""
        keys = (key for key, _ in self._newest.items() if key.startswith(f"{STATUS}/"))
        return sorted(key.removeprefix(f"{STATUS}/") for key in keys)

    def running(self) -> bool:
        """Return True if the vehicle clock runs."""
        clock = self.newest(Clock)
        return clock is not None and clock.state is ClockState.RUNNING

    def last_activity(self, node: str) -> Activity | None:
        """Return the newest message that shows that ``node`` works; None if there is none.

        While the clock runs, an estimator shows it by an estimate and a controller by a plan that the actuators have
        accepted. All other processes, and these two while the clock is paused, show it by their status. The router
        publishes none: any message that came through it counts.
        """
        if node == ROUTER:
            return Activity(0, self._newest.arrived_s)
        if node == "controller" and self.running():
            applied, frame = self.newest(Applied), self._newest.get(BY_TYPE[Applied].key)
            return None if applied is None or frame is None else Activity(applied.plan_epoch, frame.arrived_s)
        key = BY_TYPE[Estimate].key if node == "estimator" and self.running() else f"{STATUS}/{node}"
        frame = self._newest.get(key)
        if frame is None:
            return None
        try:
            return Activity(header_of(unpack(frame.payload)).epoch, frame.arrived_s)
        except WireError:
            return None

    def kill_requests(self) -> list[str]:
        """Return the processes that an operator has asked to kill since the last call."""
        nodes = []
        while (frame := self._kills.take(0.0)) is not None:
            try:
                nodes.append(decode(Kill, frame.payload)[0].node)
            except WireError:
                continue
        return nodes

    def new_events(self) -> list[RunEvent]:
        """Return the run events since the last call."""
        events = []
        while (frame := self._events.take(0.0)) is not None:
            try:
                message = message_at(BY_TYPE[RunEvent], frame.key, unpack(frame.payload))[0]
                events.append(cast(RunEvent, message))
            except WireError:
                continue
        return events

    def t_ns(self) -> int | None:
        """Return the vehicle time; None while it is not known."""
        if (message := self.newest(Clock)) is not None:
            try:
                self._clock.follow(message)
            except ClockError:
                return None
        return self._clock.read(monotonic_us())
