"""What the launcher hears of a run: the newest message of each key, decoded only when someone looks."""

from __future__ import annotations

import time
from collections.abc import Iterable
from typing import TypeVar

from ltv_mpc.signals import Applied, Clock, CycleTiming, Estimate, NodeStatus, Plan, RunEvent, Signal, Truth
from services.bus.mailbox import Mailbox
from services.bus.session import Session
from services.bus.topics import BY_SIGNAL, Topic
from services.bus.wire import WireError, decode
from services.process.clock import ClockError, VehicleClock, monotonic_us

S = TypeVar("S", bound=Signal)

SHOWN: tuple[type[Signal], ...] = (Truth, Estimate, Plan, Applied, CycleTiming, Clock)


class Newest:
    """Takes frames as a ``Mailbox`` does, and keeps the newest of each key."""

    def __init__(self) -> None:
        self._frames: dict[str, tuple[Topic, bytes, float]] = {}

    def offer(self, topic: Topic | None, key: str, payload: bytes) -> None:
        """Replace; called on Zenoh's thread."""
        if topic is not None:
            self._frames[key] = (topic, payload, time.monotonic())

    def get(self, key: str) -> tuple[Topic, bytes, float] | None:
        """Topic, payload, monotonic time of arrival (s)."""
        return self._frames.get(key)


class Watch:
    """The launcher's ears. ``nodes`` are the processes whose word it waits for."""

    def __init__(self, session: Session, nodes: Iterable[str]) -> None:
        self._newest = Newest()
        self._events = Mailbox()
        self._clock = VehicleClock()
        for kind in SHOWN:
            session.subscribe(BY_SIGNAL[kind].key, BY_SIGNAL[kind], self._newest)
        for node in nodes:
            session.subscribe(f"{BY_SIGNAL[NodeStatus].key}/{node}", BY_SIGNAL[NodeStatus], self._newest)
        session.subscribe(f"{BY_SIGNAL[RunEvent].key}/*", BY_SIGNAL[RunEvent], self._events)

    def newest(self, kind: type[S], node: str = "") -> S | None:
        """The newest signal of this kind (of this node, where every node writes it)."""
        key = BY_SIGNAL[kind].key
        frame = self._newest.get(f"{key}/{node}" if node else key)
        if frame is None:
            return None
        try:
            return decode(kind, frame[1])[0]
        except WireError:  # its readers count it
            return None

    def silent_s(self, node: str) -> float | None:
        """Since when a node has not said a word (s of wall time); None before its first."""
        frame = self._newest.get(f"{BY_SIGNAL[NodeStatus].key}/{node}")
        return None if frame is None else time.monotonic() - frame[2]

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
                self._clock.hear(message)
            except ClockError:
                return None
        return self._clock.read(monotonic_us())
