"""History of a run for a page that joins late: asked from the recorder once, before the page shows anything."""

from __future__ import annotations

import threading
import time
from typing import NamedTuple

from ltv_mpc.messages import ControllerStatus, Estimate, Message, Truth
from services.bus.roles import HISTORY
from services.bus.session import Session
from services.bus.topics import topic_at
from services.bus.wire import Header, WireError, decode
from services.recording.history import TIMES, read_reply

TIMEOUT_S = 2.0
MAX_REPLIES = 200
"""Replies that are read at most: 40 MB."""


MAX_TIME_NS = 10**19


class Past(NamedTuple):
    """Message of the past with its header."""

    message: Message
    header: Header


class HistoryQuery:
    """Query of the recorder's history. It is done when all replies have come, or after ``TIMEOUT_S``."""

    def __init__(self, session: Session) -> None:
        self._frames: list[bytes] = []
        self._given: set[tuple[type[Message], int, int]] | None = None
        self._until_s = time.monotonic() + TIMEOUT_S
        self._complete = threading.Event()
        session.ask(HISTORY, self._receive, self._complete.set, timeout_s=TIMEOUT_S)

    @property
    def awaited(self) -> bool:
        """True while replies may come."""
        return self._given is None and not self._complete.is_set() and time.monotonic() < self._until_s

    def take(self) -> list[Past]:
        """Return the messages, once, in the order of their vehicle times, those without a time first."""
        if self._given is not None:
            return []
        messages = self._messages()
        self._given = {(type(past.message), past.header.epoch, past.header.sequence) for past in messages}
        self._frames.clear()
        return messages

    def had(self, message: Message, header: Header) -> bool:
        """Return True if the history had this message, which then was sent while it was awaited."""
        return (type(message), header.epoch, header.sequence) in (self._given or ())

    def _messages(self) -> list[Past]:
        """Return the messages in order, without invalid ones and without estimates of a source that is not in use."""
        found: list[Past] = []
        for frame in list(self._frames):
            try:
                key, payloads = read_reply(frame)
                topic = topic_at(key)
            except (WireError, KeyError):
                continue
            for payload in payloads if topic is not None else ():
                assert topic is not None
                try:
                    message, header = decode(topic.message_type, payload)
                except WireError:
                    continue
                found.append(Past(message, header))
        sources = {past.message.source_epoch for past in found if isinstance(past.message, ControllerStatus)} - {0}
        if sources:
            found = [past for past in found if not isinstance(past.message, Estimate) or past.header.epoch in sources]
        return sorted(found, key=_order)

    def _receive(self, frame: bytes) -> None:
        if len(self._frames) < MAX_REPLIES:
            self._frames.append(frame)


def _order(past: Past) -> tuple[int, bool]:
    """Return a sort key: the vehicle time, then the truth first, so that the start error has one for its estimate."""
    message = past.message
    t_ns = getattr(message, TIMES.get(type(message), "t_ns"), -MAX_TIME_NS)
    return t_ns, not isinstance(message, Truth)
