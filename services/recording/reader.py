"""Reads a run's recording, from the front, message by message: also one that is being written or was cut off.

A file that ends in the middle gives every message up to its last whole one; ``Recording.cut`` then says so. The index
at the end is not needed.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import zstandard
from mcap.exceptions import InvalidMagic, McapError
from mcap.records import Channel, Message, Metadata
from mcap.stream_reader import CRCValidationError, StreamReader

from ltv_mpc.errors import ConfigError
from ltv_mpc.signals import Signal
from services.bus import topics, wire
from services.recording.writer import RUN

TORN = (McapError, CRCValidationError, struct.error, zstandard.ZstdError, UnicodeDecodeError)
"""What mcap, zstd and struct raise at the place where a file was torn."""


class Recorded(msgspec.Struct, frozen=True):
    """One message. ``t_ns`` is the vehicle time of its publication; ``plain`` its map, header included.

    ``kind`` is None where the table of topics has no such key.
    """

    key: str
    kind: type[Signal] | None
    t_ns: int
    plain: dict[str, Any]

    def typed(self) -> tuple[Signal, wire.Header]:
        """The signal and its header. Raises ``WireError`` where it is no such message."""
        if self.kind is None:
            raise wire.WireError(f"no topic has the key {self.key}")
        return wire.typed(self.kind, self.plain)


class Recording:
    """A file that was opened; iterating reads it from the front. ``metadata`` is complete once iteration began."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.metadata: dict[str, str] = {}
        self.cut = False

    def __iter__(self) -> Iterator[Recorded]:
        decode = msgspec.json.Decoder(dict[str, Any]).decode
        channels: dict[int, tuple[str, type[Signal] | None]] = {}
        start_ns = 0
        with self.path.open("rb") as file:
            for record in self._records(StreamReader(file, validate_crcs=True)):
                if isinstance(record, Message):
                    key, kind = channels[record.channel_id]
                    yield Recorded(key, kind, record.log_time + start_ns, decode(record.data))
                elif isinstance(record, Channel):
                    topic = topics.topic_at(record.topic)
                    channels[record.id] = (record.topic, topic.signal if topic else None)
                elif isinstance(record, Metadata) and record.name == RUN:
                    self.metadata = record.metadata
                    start_ns = int(record.metadata["start_ns"])

    def _records(self, stream: StreamReader) -> Iterator[object]:
        try:
            yield from stream.records
        except InvalidMagic:
            raise ConfigError(f"recording {self.path}", "", "not an MCAP file") from None
        except TORN:
            self.cut = True
