"""How one process publishes: each signal on its type's key, numbered by key from 0, under the process's epoch."""

from __future__ import annotations

import secrets
import time
from collections.abc import Iterable
from typing import NamedTuple

from ltv_mpc.messages import Message
from services.bus.session import Publisher, Session
from services.bus.topics import key_of
from services.bus.wire import Header, crc, encode


def new_epoch() -> int:
    """48 random bits for each start of a process: exact in every language, never 0."""
    return secrets.randbits(48) or 1


class SentFrame(NamedTuple):
    """What went out, by which anyone finds it again."""

    key: str
    sequence: int
    crc: int


class Outbox:
    """The ways out of one process. ``published`` counts every message, whichever its key."""

    def __init__(
        self, session: Session, *, node: str, epoch: int, kinds: Iterable[type[Message]], key_prefix: str = ""
    ) -> None:
        """``key_prefix`` is put before every key, where one session serves several vehicles."""
        self.epoch = epoch
        self.published = 0
        self._keys = {
            kind: f"{key_prefix}/{key_of(kind, node)}" if key_prefix else key_of(kind, node) for kind in kinds
        }
        self._publishers: dict[str, Publisher] = {key: session.publisher(key) for key in self._keys.values()}
        self._sequence = dict.fromkeys(self._publishers, 0)

    def publish(self, signal: Message) -> SentFrame:
        """Number, encode and send. ``signal`` is of one of the kinds that were declared."""
        key = self._keys[type(signal)]
        sequence = self._sequence[key]
        header = Header(epoch=self.epoch, sequence=sequence, sent_monotonic_us=time.monotonic_ns() // 1000)
        payload = encode(signal, header)
        self._sequence[key] = sequence + 1
        self.published += 1
        self._publishers[key].put(payload)
        return SentFrame(key, sequence, crc(payload))
