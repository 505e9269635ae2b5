"""Outbox of a process: each message goes out on the key of its type, numbered by key from 0, under one epoch."""

from __future__ import annotations

import secrets
import time
from collections.abc import Iterable, Iterator
from itertools import count
from typing import NamedTuple

from ltv_mpc.messages import Message
from services.bus.session import Publisher, Session
from services.bus.topics import key_of
from services.bus.wire import Header, crc, encode


def new_epoch() -> int:
    """Return a random epoch for one start of a process: 48 bits, which every language holds exactly, and never 0."""
    return secrets.randbits(48) or 1


class SentMessage(NamedTuple):
    """Identification of a published message; ``crc`` is that of its frame."""

    key: str
    sequence: int
    crc: int


class Outbox:
    """Publishers of one process. ``published`` counts the messages of all keys."""

    def __init__(
        self, session: Session, *, node: str, epoch: int, kinds: Iterable[type[Message]], key_prefix: str = ""
    ) -> None:
        """Declare a publisher for each kind; ``key_prefix`` precedes every key if a session serves several vehicles."""
        self.epoch = epoch
        self.published = 0
        self._outlets: dict[type[Message], tuple[str, Publisher, Iterator[int]]] = {}
        for kind in dict.fromkeys(kinds):
            key = "/".join((*([key_prefix] if key_prefix else ()), key_of(kind, node)))
            self._outlets[kind] = key, session.publisher(key), count()

    def publish(self, message: Message) -> SentMessage:
        """Add the header to a message of a declared kind, encode it and send it."""
        (sent,) = self.publish_all((message,))
        return sent

    def publish_all(self, messages: Iterable[Message]) -> list[SentMessage]:
        """Encode all messages, then send them at once: Zenoh then puts their frames into few packets."""
        frames = []
        for message in messages:
            key, publisher, numbers = self._outlets[type(message)]
            header = Header(epoch=self.epoch, sequence=next(numbers), sent_monotonic_us=time.monotonic_ns() // 1000)
            payload = encode(message, header)
            frames.append((publisher, payload, SentMessage(key, header.sequence, crc(payload))))
        for publisher, payload, _ in frames:
            publisher.put(payload)
        self.published += len(frames)
        return [sent for _, _, sent in frames]
