"""Decimated history of a run for pages that join late: constant size, kept in the recorder's memory.

Sampled messages are kept at a period that doubles whenever ``LIMIT`` would be exceeded twice; of events the newest are
kept. The first sample of each period stays, so that the start at t = 0 stays too. The largest parts, which a plot over
time does not need, are left out: the current profile of an estimate, and of a plan all knots but two.

A reply is one part of the history, and the page asks for the next part when it has the last. All parts at once filled
a router's queue to the page, and a router with one thread then forwarded nothing for 5 s.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Mapping
from typing import Any, NamedTuple

import msgspec

from ltv_mpc.messages import (
    Acknowledgement,
    Applied,
    Command,
    ControllerStatus,
    CycleTiming,
    Estimate,
    LocalisationReport,
    Message,
    NodeSettings,
    Plan,
    RunEvent,
    Truth,
)
from services.bus.wire import pack

LIMIT = 1000
"""A type has fewer than twice as many messages: about 8 MB in all."""

REPLY_BYTES = 200_000

TIMES = {Truth: "t_ns", Estimate: "t_ns", Applied: "t_ns", Plan: "cycle_t_ns", CycleTiming: "t_ns"}
"""Field with the vehicle time of the sampled messages."""

FIRST_PERIOD_NS = 200_000_000
EVENTS = (RunEvent, Command, Acknowledgement, LocalisationReport, NodeSettings, ControllerStatus)
"""Messages of which the newest ``LIMIT`` are kept; of the last two, which repeat themselves, the newest of each key."""
REPEATED = (NodeSettings, ControllerStatus)


class Part(msgspec.Struct):
    """Reply of the recorder to a query, the number of the first message that is asked for; both in msgpack."""

    messages: list[tuple[str, bytes]]
    """keys and payloads, oldest first"""
    next: int | None
    """number to ask for next; None: that was all"""


class Entry(NamedTuple):
    """Message that is kept."""

    t_ns: int
    number: int = 0  # of its arrival, among all messages
    payload: bytes = b""


class Samples:
    """Messages of one source, the first of each ``period_ns``, which doubles to keep fewer than ``2 * limit``."""

    def __init__(self, period_ns: int, limit: int) -> None:
        self.kept: list[Entry] = []
        self._period_ns, self._limit = period_ns, limit

    def is_due(self, t_ns: int) -> bool:
        """Return True if a message of this time is the first of its period."""
        return not self.kept or t_ns // self._period_ns != self.kept[-1].t_ns // self._period_ns

    def add(self, entry: Entry) -> None:
        """Add a message that is due."""
        self.kept.append(entry)
        if len(self.kept) < 2 * self._limit:
            return
        self._period_ns *= 2
        kept, self.kept = self.kept, []
        for entry in kept:
            if self.is_due(entry.t_ns):
                self.kept.append(entry)


class History:
    """History of a run. ``add`` is called by the recorder, ``reply`` by Zenoh's thread, which answers a query."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._number = 0
        self._samples: dict[tuple[str, type[Message]], Samples] = {}
        self._events: dict[tuple[str, type[Message]], deque[Entry]] = {}

    def add(self, key: str, kind: type[Message], message: Mapping[str, Any]) -> None:
        """Add a message as it is recorded: the plain map of its frame."""
        with self._lock:
            self._number += 1
            if kind in EVENTS:
                limit = 1 if kind in REPEATED else LIMIT
                events = self._events.setdefault((key, kind), deque(maxlen=limit))
                events.append(Entry(0, self._number, pack(message)))
            elif kind in TIMES and isinstance(t_ns := message.get(TIMES[kind]), int):
                samples = self._samples.setdefault((key, kind), Samples(FIRST_PERIOD_NS, LIMIT))
                if samples.is_due(t_ns):
                    samples.add(Entry(t_ns, self._number, pack(_shortened(kind, message))))

    def reply(self, first: int) -> bytes:
        """Return the messages from number ``first`` on, as an encoded ``Part`` of about ``REPLY_BYTES``."""
        with self._lock:
            kept = [*self._events.items(), *((source, samples.kept) for source, samples in self._samples.items())]
            later = [(one.number, key, one.payload) for (key, _), of in kept for one in of if one.number >= first]
        part, size = Part([], None), 0
        for number, key, payload in sorted(later):
            if size > REPLY_BYTES:
                part.next = number
                break
            part.messages.append((key, payload))
            size += len(payload)
        return msgspec.msgpack.encode(part)


def _shortened(kind: type[Message], message: Mapping[str, Any]) -> Mapping[str, Any]:
    if kind is Estimate:
        return {**message, "current": None}
    if kind is Plan:
        knots = ("t_ns", "thrust_N", "states")
        return {**message, **{name: message[name][:2] for name in knots if isinstance(message.get(name), list)}}
    return message
