"""Outbox of a process: each message goes out on the key of its type, numbered by key from 0, under one epoch."""

from __future__ import annotations

import secrets
import time
from collections.abc import Iterable
from typing import NamedTuple

from ltv_mpc.messages import Message
from services.bus.session import Publisher, Session
from services.bus.topics import BATCHED, key_of
from services.bus.wire import Header, crc, encode

MAX_FRAME_BYTES = 16_384
"""Largest frame of several messages, well below one packet of Zenoh (64 KiB)."""


def new_epoch() -> int:
    """Return a random epoch for one start of a process: 48 bits, which every language holds exactly, and never 0."""
    return secrets.randbits(48) or 1


class SentMessage(NamedTuple):
    """Identification of a published message; ``crc`` is that of its own payload."""

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
        self._keys = {
            kind: f"{key_prefix}/{key_of(kind, node)}" if key_prefix else key_of(kind, node) for kind in kinds
        }
        self._publishers: dict[str, Publisher] = {key: session.publisher(key) for key in self._keys.values()}
        self._sequence = dict.fromkeys(self._publishers, 0)

    def publish(self, message: Message) -> SentMessage:
        """Add the header to a message of a declared kind, encode it and send it."""
        (sent,) = self.publish_all((message,))
        return sent

    def publish_all(self, messages: Iterable[Message]) -> list[SentMessage]:
        """Encode all messages, then send them at once: Zenoh then puts their frames into few packets.

        Messages of a ``BATCHED`` type share frames, which are sent at the place of the last of their messages.
        """
        sent_messages: list[SentMessage] = []
        frames: dict[tuple[str, int], bytes] = {}  # by key and sequence number of the last message
        for message in messages:
            sent, payload = self._encoded(message)
            sent_messages.append(sent)
            if type(message) in BATCHED:
                before = sent.key, sent.sequence - 1
                if before in frames and len(frames[before]) + len(payload) <= MAX_FRAME_BYTES:
                    payload = frames.pop(before) + payload
            frames[sent.key, sent.sequence] = payload
        for (key, _), frame in frames.items():
            self._publishers[key].put(frame)
        self.published += len(sent_messages)
        return sent_messages

    def _encoded(self, message: Message) -> tuple[SentMessage, bytes]:
        key = self._keys[type(message)]
        sequence = self._sequence[key]
        header = Header(epoch=self.epoch, sequence=sequence, sent_monotonic_us=time.monotonic_ns() // 1000)
        payload = encode(message, header)
        self._sequence[key] = sequence + 1
        return SentMessage(key, sequence, crc(payload)), payload
