"""A whole recording out of one that was cut, damaged, or left in segments: run.mcap, run.2.mcap, run.3.mcap, ...

A recorder that is killed leaves a file without an end; one that is started again goes on in the next segment. Messages
are copied as they are, byte for byte and in their order; only ``log_time`` is moved where a segment counts from another
start than the first. What was lost stands in the metadata record ``recovery`` of the file that is made.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, BinaryIO, TypeAlias

import msgspec
from mcap.records import Channel, Message, Metadata, Schema
from mcap.writer import CompressionType, Writer

from ltv_mpc.errors import ConfigError
from services.recording.records import Loss, Records, start_of
from services.recording.writer import CHUNK_BYTES, LIBRARY, PROFILE, RUN

RECOVERY = "recovery"
"""Name of the metadata record."""

_NUMBERED = re.compile(r"(.+)\.(\d+)")


class RecoveredSegment(msgspec.Struct, frozen=True, kw_only=True):
    """One segment."""

    file: str
    size_bytes: int
    messages: int
    whole: bool
    lost_bytes: int
    orphans: int  # messages whose channel is named in a lost part
    losses: tuple[Loss, ...]


class Recovery(msgspec.Struct, frozen=True, kw_only=True):
    """What was made of what."""

    file: str
    messages: int
    lost_bytes: int
    segments: tuple[RecoveredSegment, ...]


def segments(recording: Path) -> tuple[Path, ...]:
    """The recording and what restarted recorders have written beside it: run.mcap, run.2.mcap, ... that are there."""
    found: list[tuple[int, Path]] = []
    for path in recording.parent.glob("*.mcap"):
        match = _NUMBERED.fullmatch(path.stem)
        if match is not None and match[1] == recording.stem:
            found.append((int(match[2]), path))
    return (recording, *(path for _, path in sorted(found)))


def recovered_path(recording: Path) -> Path:
    """Where a recovery goes: run.recovered.mcap beside run.mcap."""
    return recording.with_name(f"{recording.stem}.recovered.mcap")


def is_whole(recording: Path) -> bool:
    """Whether the file has its end and nothing in it is damaged. Raises ``ConfigError`` where it is no MCAP file."""
    records = Records(recording)
    for _ in records:
        pass
    return records.whole


def recover(parts: Sequence[Path], out: Path) -> Recovery:
    """Every whole message of the segments, in their order, into ``out``.

    Raises ``ConfigError`` where ``out`` exists already, a segment is no MCAP file, or there is not one whole message.
    """
    try:
        file = out.open("xb")
    except FileExistsError:
        raise ConfigError(f"recovery {out}", "", "exists: name another with --out") from None
    try:
        with file:
            made = _Copy(file).of(parts, out)
        if not made.messages:
            raise ConfigError(f"recording {parts[0]}", "", "holds no complete message: nothing can be recovered")
    except BaseException:
        out.unlink()
        raise
    return made


class _Copy:
    """Into one file: schemas and channels once each, whatever numbers the segments gave them."""

    def __init__(self, file: BinaryIO) -> None:
        # Any: the package leaves the types of some of its methods out.
        self._mcap: Any = Writer(file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._schemas: dict[tuple[str, str, bytes], int] = {}
        self._channels: dict[str, int] = {}
        self._start_ns: int | None = None

    def of(self, parts: Sequence[Path], out: Path) -> Recovery:
        self._mcap.start(PROFILE, LIBRARY)
        salvaged = tuple(self._segment(Records(path)) for path in parts)
        made = Recovery(
            file=str(out),
            messages=sum(part.messages for part in salvaged),
            lost_bytes=sum(part.lost_bytes for part in salvaged),
            segments=salvaged,
        )
        words = {part.file: f"{part.messages} messages, {part.lost_bytes} bytes lost" for part in salvaged}
        self._mcap.add_metadata(RECOVERY, words)
        self._mcap.finish()
        return made

    def _segment(self, records: Records) -> RecoveredSegment:
        schemas: dict[int, Schema] = {}
        channels: dict[int, int] = {}
        shift_ns = messages = 0
        for record in records:
            match record:
                case Message():
                    self._message(channels[record.channel_id], record, shift_ns)
                    messages += 1
                case Schema():
                    schemas[record.id] = record
                case Channel():
                    channels[record.id] = self._channel(record, schemas.get(record.schema_id))
                case Metadata() if record.name == RUN:
                    shift_ns = self._begin(record)
                case Metadata():
                    self._mcap.add_metadata(record.name, record.metadata)
        return RecoveredSegment(
            file=records.path.name,
            size_bytes=records.size,
            messages=messages,
            whole=records.whole,
            lost_bytes=records.lost_bytes,
            orphans=records.orphans,
            losses=tuple(records.losses),
        )

    def _message(self, channel: int, message: Message, shift_ns: int) -> None:
        at = min(max(0, message.log_time + shift_ns), 2**64 - 1)
        self._mcap.add_message(channel, at, message.data, at, message.sequence)

    def _begin(self, record: Metadata) -> int:
        """How much later this segment's log time is than the first one's; of the first its account is kept."""
        start_ns = start_of(record.metadata)
        if self._start_ns is None:
            self._start_ns = start_ns
            self._mcap.add_metadata(RUN, record.metadata)
        return start_ns - self._start_ns

    def _channel(self, channel: Channel, schema: Schema | None) -> int:
        if channel.topic not in self._channels:
            kind = 0 if schema is None else self._schema(schema)
            number: int = self._mcap.register_channel(channel.topic, channel.message_encoding, kind, channel.metadata)
            self._channels[channel.topic] = number
        return self._channels[channel.topic]

    def _schema(self, schema: Schema) -> int:
        name = (schema.name, schema.encoding, schema.data)
        if name not in self._schemas:
            self._schemas[name] = self._mcap.register_schema(*name)
        return self._schemas[name]


class RawMessage(msgspec.Struct, frozen=True):
    """One message as the file holds it: its key, vehicle time of publication, and JSON."""

    key: str
    t_ns: int
    data: bytes


class SegmentReader:
    """The messages of one segment; ``metadata`` is what the run was made of, complete once iteration began.

    ``others`` holds further metadata by the name of its record, complete at the end.
    """

    def __init__(self, path: Path) -> None:
        self.records = Records(path)
        self.metadata: dict[str, str] = {}
        self.others: dict[str, dict[str, str]] = {}

    def __iter__(self) -> Iterator[RawMessage]:
        keys: dict[int, str] = {}
        start_ns = 0
        for record in self.records:
            match record:
                case Message():
                    yield RawMessage(keys[record.channel_id], record.log_time + start_ns, record.data)
                case Channel():
                    keys[record.id] = record.topic
                case Metadata() if record.name == RUN:
                    self.metadata = record.metadata
                    start_ns = start_of(record.metadata)
                case Metadata():
                    self.others[record.name] = record.metadata
                case _:
                    pass


Progress: TypeAlias = Callable[[float], None]
"""Is told which share of the work is done, 0 to 1, at most every ``PROGRESS_INTERVAL`` messages."""
PROGRESS_INTERVAL = 1000


def no_progress(share: float) -> None:
    """Tell nobody."""


def read_segments(
    parts: Sequence[Path], progress: Progress, share: tuple[float, float] = (0.0, 1.0)
) -> Iterator[tuple[SegmentReader, RawMessage]]:
    """Every message of the segments in their order; ``progress`` on the way from the first to the second ``share``."""
    sizes = [path.stat().st_size for path in parts]
    before, total = 0, max(1, sum(sizes))
    for path, size in zip(parts, sizes, strict=True):
        lines = SegmentReader(path)
        for count, line in enumerate(lines):
            if count % PROGRESS_INTERVAL == 0:
                progress(share[0] + (share[1] - share[0]) * (before + lines.records.position) / total)
            yield lines, line
        before += size
