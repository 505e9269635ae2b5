"""Reads a run's recording, from the front, message by message: also one that is being written or was cut off.

A file that ends in the middle gives every message up to its last whole one; ``Recording.cut`` then says so. The index
at the end is not needed.
"""

from __future__ import annotations

from collections.abc import Container, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
from mcap.records import Channel, Metadata
from mcap.records import Message as McapMessage

from ltv_mpc.messages import Message
from services.bus import topics, wire
from services.recording.records import Record, Records, start_of
from services.recording.writer import RUN


class RecordedMessage(msgspec.Struct, frozen=True):
    """One message. ``t_ns`` is the vehicle time of its publication; ``plain`` its map, header included.

    ``kind`` is None where the table of topics has no such key.
    """

    key: str
    kind: type[Message] | None
    t_ns: int
    plain: dict[str, Any]

    def typed(self) -> tuple[Message, wire.Header]:
        """The signal and its header. Raises ``WireError`` where it is no such message."""
        if self.kind is None:
            raise wire.WireError(f"no topic has the key {self.key}")
        return wire.from_map(self.kind, self.plain)


class StoredMessage(NamedTuple):
    """One message as it stands in the file: ``data`` is its JSON, ``crc`` that of the frame as it was received."""

    key: str
    kind: type[Message] | None
    t_ns: int
    crc: int
    data: bytes


class Recording:
    """A file that was opened; iterating reads it from the front. ``metadata`` is complete once iteration began."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.metadata: dict[str, str] = {}
        self.cut = False

    def __iter__(self) -> Iterator[RecordedMessage]:
        decode = msgspec.json.Decoder(dict[str, Any]).decode
        for key, kind, t_ns, _, data in self.stored():
            try:
                plain = decode(data)
            except (msgspec.DecodeError, ValueError, RecursionError):  # nobody that writes recordings wrote it
                self.cut = True
                return
            yield RecordedMessage(key, kind, t_ns, plain)

    def stored(self, keys: Container[str] | None = None) -> Iterator[StoredMessage]:
        """The messages undecoded; ``keys`` are those that are wanted, None: all."""
        channels: dict[int, tuple[str, type[Message] | None] | None] = {}
        start_ns = 0
        for record in self._records():
            if isinstance(record, McapMessage):
                channel = channels[record.channel_id]
                if channel is not None:
                    yield StoredMessage(*channel, record.log_time + start_ns, record.sequence, record.data)
            elif isinstance(record, Channel):
                topic = topics.topic_at(record.topic)
                wanted = keys is None or record.topic in keys
                channels[record.id] = (record.topic, topic.message_type if topic else None) if wanted else None
            elif isinstance(record, Metadata) and record.name == RUN:
                self.metadata = record.metadata
                start_ns = start_of(record.metadata)

    def _records(self) -> Iterator[Record]:
        """Up to the first that is lost: what follows it would seem to follow what comes before it."""
        records = Records(self.path)
        self.cut = False
        for record in records:
            if records.losses or records.orphans:
                break
            yield record
        self.cut = not records.whole
