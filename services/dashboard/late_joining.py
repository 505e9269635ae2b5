"""History of a run for a page that joins late: asked from the recorder before the page shows anything.

A page that was there before the recorder asks in vain. If a busy machine then keeps it from reading, so that its data
begin late, it asks once more.
"""

from __future__ import annotations

import threading
import time
from itertools import chain
from typing import TypeAlias

import msgspec

from ltv_mpc.messages import ControllerStatus, Estimate, Message, Truth
from services.bus.mailbox import Frame
from services.bus.roles import HISTORY
from services.bus.session import Session
from services.bus.topics import topic_at
from services.bus.wire import Header
from services.recording.history import TIMES, Part

TIMEOUT_S = 2.0
MAX_REPLIES = 200
"""Replies that are read at most: 40 MB."""


MAX_TIME_NS = 10**19


Past: TypeAlias = tuple[Message, Header]
"""Message of the past with its header."""


class HistoryQuery:
    """Query of the recorder's history, part by part. It is done when the last part has come, or after ``TIMEOUT_S``."""

    def __init__(self, session: Session, *, last: bool = False) -> None:
        self._session = session
        self._last = last
        self._parts: list[list[tuple[str, bytes]]] = []
        self._given: set[tuple[type[Message], int, int]] | None = None
        self._until_s = time.monotonic() + TIMEOUT_S
        self._complete = threading.Event()
        threading.Thread(target=self._ask, name="history", daemon=True).start()

    def again(self) -> HistoryQuery:
        """Return a second query; this one if it is the second."""
        return self if self._last else HistoryQuery(self._session, last=True)

    @property
    def awaited(self) -> bool:
        """True while replies may come."""
        return self._given is None and not self._complete.is_set() and time.monotonic() < self._until_s

    def take(self) -> list[Past]:
        """Return the messages, once, in the order of their vehicle times, those without a time first."""
        if self._given is not None:
            return []
        messages = self._messages()
        self._given = {(type(message), header.epoch, header.sequence) for message, header in messages}
        self._parts = []
        return messages

    def had(self, message: Message, header: Header) -> bool:
        """Return True if the history had this message, which then was sent while it was awaited."""
        return (type(message), header.epoch, header.sequence) in (self._given or ())

    def _messages(self) -> list[Past]:
        """Return the messages in order, without invalid ones and without estimates of a source that is not in use."""
        frames = (Frame(topic_at(key), key, payload) for key, payload in chain.from_iterable(list(self._parts)))
        found = [frame.decoded for frame in frames if frame.decoded is not None]
        sources = {message.source_epoch for message, _ in found if isinstance(message, ControllerStatus)} - {0}
        if sources:
            found = [past for past in found if not isinstance(past[0], Estimate) or past[1].epoch in sources]
        return sorted(found, key=_order)

    def _ask(self) -> None:
        first: int | None = 0
        while first is not None and self.awaited and len(self._parts) < MAX_REPLIES:
            reply = self._session.ask(HISTORY, msgspec.msgpack.encode(first), timeout_s=TIMEOUT_S)
            try:
                part = Part([], None) if reply is None else msgspec.msgpack.decode(reply, type=Part)
            except msgspec.MsgspecError:
                break
            self._parts.append(part.messages)
            first = part.next
        self._complete.set()


def _order(past: Past) -> tuple[int, bool]:
    """Return a sort key: the vehicle time, then the truth first, so that the start error has one for its estimate."""
    message = past[0]
    t_ns = getattr(message, TIMES.get(type(message), "t_ns"), -MAX_TIME_NS)
    return t_ns, not isinstance(message, Truth)
