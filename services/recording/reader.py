"""Reader of a recording, sequential and message by message, also while it is being written or after it was truncated.

A truncated file yields every message up to its last complete one; ``Recording.cut`` is then True. The index at the end
of the file is not needed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import msgspec
from mcap.records import Channel, Metadata, Schema
from mcap.records import Message as McapMessage

from ltv_mpc.messages import Message
from services.bus import topics, wire
from services.recording.records import Records, start_of
from services.recording.writer import RUN


class StoredMessage(NamedTuple):
    """Message as stored in the file: ``data`` is its JSON, ``crc`` the CRC-32 of the frame as it was received.

    ``t_ns`` is the vehicle time of publication. ``kind`` is None if the table of topics has no such key.
    """

    key: str
    kind: type[Message] | None
    t_ns: int
    crc: int
    data: bytes

    def header(self) -> wire.Header:
        """Return the header. Raises ``WireError``."""
        return _decoded(_header, self.data)

    @property
    def plain(self) -> dict[str, Any]:
        """Map of the message, including the fields of its header. Raises ``WireError``."""
        return _decoded(_map, self.data)

    def message(self) -> Message:
        """Return the message, as it was accepted when it was recorded. Raises ``WireError``."""
        return wire.from_validated_map(self._known_kind, self.plain)

    def typed(self) -> tuple[Message, wire.Header]:
        """Return the message and its header. Raises ``WireError`` if it is not a valid message of its type."""
        return wire.from_map(self._known_kind, self.plain)

    @property
    def _known_kind(self) -> type[Message]:
        if self.kind is None:
            raise wire.WireError(f"no topic has the key {self.key}")
        return self.kind


_header = msgspec.json.Decoder(wire.Header).decode
_map = msgspec.json.Decoder(dict[str, Any]).decode
_T = TypeVar("_T")


def _decoded(decode: Callable[[bytes], _T], data: bytes) -> _T:
    try:
        return decode(data)
    except (msgspec.MsgspecError, ValueError, RecursionError) as error:  # not written by a recorder
        raise wire.WireError(str(error)) from None


class Recording:
    """Recording of one file, or of a run's segments in their order; iteration reads it from the start.

    ``metadata``, those of the first file that has any, are complete once iteration has started, ``others``, the other
    metadata records by name, after it. It continues behind a loss; ``parts`` have the losses.
    """

    def __init__(self, *paths: Path) -> None:
        self.metadata: dict[str, str] = {}
        self.others: dict[str, dict[str, str]] = {}
        self.channels: dict[str, tuple[Channel, Schema | None]] = {}
        """First channel of each key that has been read, with its schema."""
        self.parts = tuple(map(Records, paths))

    @property
    def cut(self) -> bool:
        """True after iteration if a file is incomplete or damaged."""
        return not all(part.whole for part in self.parts)

    def __iter__(self) -> Iterator[StoredMessage]:
        return self.stored()

    def stored(self, wanted: Callable[[str], bool] = lambda _: True) -> Iterator[StoredMessage]:
        """Yield the messages without decoding them; ``wanted`` selects them by their key."""
        return chain.from_iterable(self._stored(part, wanted) for part in self.parts)

    def _stored(self, records: Records, wanted: Callable[[str], bool]) -> Iterator[StoredMessage]:
        channels: dict[int, tuple[str, type[Message] | None] | None] = {}
        start_ns = 0
        for record in records:
            if isinstance(record, McapMessage):
                channel = channels[record.channel_id]
                if channel is not None:
                    yield StoredMessage(*channel, record.log_time + start_ns, record.sequence, record.data)
            elif isinstance(record, Channel):
                topic = topics.topic_at(record.topic)
                channel = record.topic, topic.message_type if topic else None
                channels[record.id] = channel if wanted(record.topic) else None
                self.channels.setdefault(record.topic, (record, records.schemas.get(record.schema_id)))
            elif isinstance(record, Metadata) and record.name == RUN:
                self.metadata = self.metadata or record.metadata
                start_ns = start_of(record.metadata)
            elif isinstance(record, Metadata):
                self.others[record.name] = record.metadata


def metadata_of(path: Path) -> dict[str, str]:
    """Return the metadata of a recording. Raises ``ConfigError`` if it is not a recording."""
    recording = Recording(path)
    next(recording.stored(), None)
    return recording.metadata
