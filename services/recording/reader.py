"""Reader of a recording, sequential and message by message, also while it is being written or after it was truncated.

A truncated file yields every message up to its last complete one; ``Recording.cut`` is then True. The index at the end
of the file is not needed.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterator
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import msgspec
from mcap.records import Channel, Metadata
from mcap.records import Message as McapMessage

from ltv_mpc.messages import Message
from services.bus import topics, wire
from services.recording.records import Record, Records, start_of
from services.recording.writer import RUN


class RecordedMessage(msgspec.Struct, frozen=True):
    """Decoded message of a recording. ``plain`` is its map, including the header fields.

    ``t_ns`` is the vehicle time of publication. ``kind`` is None if the table of topics has no such key.
    """

    key: str
    kind: type[Message] | None
    t_ns: int
    plain: dict[str, Any]

    def typed(self) -> tuple[Message, wire.Header]:
        """Return the typed message and its header. Raises ``WireError`` if it is not a valid message of its type."""
        if self.kind is None:
            raise wire.WireError(f"no topic has the key {self.key}")
        return wire.from_map(self.kind, self.plain)


class StoredMessage(NamedTuple):
    """Message as stored in the file: ``data`` is its JSON, ``crc`` the CRC-32 of the frame as it was received."""

    key: str
    kind: type[Message] | None
    t_ns: int
    crc: int
    data: bytes

    def header(self) -> wire.Header:
        """Return the header. Raises ``WireError``."""
        return _decoded(_header, self.data)

    def message(self) -> Message:
        """Return the message, as it was accepted when it was recorded. Raises ``WireError``."""
        if self.kind is None:
            raise wire.WireError(f"{self.key}: no topic has this key")
        return wire.from_validated_map(self.kind, _decoded(msgspec.json.decode, self.data))


_header = msgspec.json.Decoder(wire.Header).decode
_T = TypeVar("_T")


def _decoded(decode: Callable[[bytes], _T], data: bytes) -> _T:
    try:
        return decode(data)
    except (msgspec.MsgspecError, ValueError, RecursionError) as error:  # not written by a recorder
        raise wire.WireError(str(error)) from None


class Recording:
    """Recording file; iteration reads it from the start. ``metadata`` is complete once iteration has started."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.metadata: dict[str, str] = {}
        self.cut = False

    def __iter__(self) -> Iterator[RecordedMessage]:
        decode = msgspec.json.Decoder(dict[str, Any]).decode
        for key, kind, t_ns, _, data in self.stored():
            try:
                plain = decode(data)
            except (msgspec.DecodeError, ValueError, RecursionError):  # not written by a recorder
                self.cut = True
                return
            yield RecordedMessage(key, kind, t_ns, plain)

    def stored(self, keys: Container[str] | None = None) -> Iterator[StoredMessage]:
        """Yield the messages without decoding them; ``keys`` selects them, None: all."""
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
        """Yield the records up to the first loss: the ones behind it would seem to follow those before it."""
        records = Records(self.path)
        self.cut = False
        for record in records:
            if records.losses or records.orphans:
                break
            yield record
        self.cut = not records.whole
