"""Decimated history of a run for pages that join late: constant size, kept in the recorder's memory.

Sampled messages are kept at a period that doubles whenever ``LIMIT`` would be exceeded twice; of events the newest are
kept. The first sample of each period stays, so that the start at t = 0 stays too. The largest parts, which a plot over
time does not need, are left out: the current profile of an estimate, and of a plan all knots but two.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterator, Mapping
from typing import Any

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
from services.bus.wire import pack, unpack

LIMIT = 1000
"""A type has fewer than twice as many messages: about 8 MB in all."""

REPLY_BYTES = 200_000

TIMES = {Truth: "t_ns", Estimate: "t_ns", Applied: "t_ns", Plan: "cycle_t_ns", CycleTiming: "t_ns"}
"""Field with the vehicle time of the sampled messages."""

FIRST_PERIOD_NS = 200_000_000
EVENTS = (RunEvent, Command, Acknowledgement, LocalisationReport, NodeSettings, ControllerStatus)
"""Messages of which the newest ``LIMIT`` are kept; of the last two, which repeat themselves, the newest of each key."""
REPEATED = (NodeSettings, ControllerStatus)


class _Samples:
    """Messages of one key, the first of each period."""

    def __init__(self) -> None:
        self.kept: list[tuple[int, bytes]] = []
        self._period_ns = FIRST_PERIOD_NS

    def is_due(self, t_ns: int) -> bool:
        return not self.kept or t_ns // self._period_ns != self.kept[-1][0] // self._period_ns

    def add(self, t_ns: int, payload: bytes) -> None:
        self.kept.append((t_ns, payload))
        if len(self.kept) < 2 * LIMIT:
            return
        self._period_ns *= 2
        kept, self.kept = self.kept, []
        for t_ns, payload in kept:
            if self.is_due(t_ns):
                self.kept.append((t_ns, payload))


class History:
    """History of a run. ``add`` is called by the recorder, ``replies`` by the thread that answers a query."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._samples: dict[tuple[str, type[Message]], _Samples] = {}
        self._events: dict[tuple[str, type[Message]], deque[bytes]] = {}

    def add(self, key: str, kind: type[Message], message: Mapping[str, Any]) -> None:
        """Add a message as it is recorded: the plain map of its frame."""
        with self._lock:
            if kind in EVENTS:
                limit = 1 if kind in REPEATED else LIMIT
                self._events.setdefault((key, kind), deque(maxlen=limit)).append(pack(message))
            elif kind in TIMES and isinstance(t_ns := message.get(TIMES[kind]), int):
                samples = self._samples.setdefault((key, kind), _Samples())
                if samples.is_due(t_ns):
                    samples.add(t_ns, pack(_shortened(kind, message)))

    def replies(self) -> Iterator[bytes]:
        """Return the history as frames of at most about ``REPLY_BYTES``, each with the messages of one key."""
        with self._lock:
            content = {key: list(events) for (key, _), events in self._events.items()}
            content |= {key: [payload for _, payload in one.kept] for (key, _), one in self._samples.items()}
        for key, payloads in content.items():
            part: list[bytes] = []
            size = 0
            for payload in payloads:
                part.append(payload)
                size += len(payload)
                if size > REPLY_BYTES:
                    yield pack({"key": key, "payloads": part})
                    part, size = [], 0
            if part:
                yield pack({"key": key, "payloads": part})


def read_reply(frame: bytes) -> tuple[str, list[bytes]]:
    """Return the key and the payloads of a reply. Raises ``WireError`` or ``KeyError`` if it is none."""
    content = unpack(frame)
    return str(content["key"]), [payload for payload in content["payloads"] if isinstance(payload, bytes)]


def _shortened(kind: type[Message], message: Mapping[str, Any]) -> Mapping[str, Any]:
    if kind is Estimate:
        return {**message, "current": None}
    if kind is Plan:
        knots = ("t_ns", "thrust_N", "states")
        return {**message, **{name: message[name][:2] for name in knots if isinstance(message.get(name), list)}}
    return message
