"""Recovery of a truncated or damaged recording, or of one in segments: run.mcap, run.2.mcap, run.3.mcap, ...

A recorder that is killed leaves a file without an end; a restarted recorder continues in the next segment. Messages are
copied byte for byte, in their order. Only ``log_time`` is shifted if a segment has another start than the first. The
metadata record ``recovery`` of the new file lists what was lost.
"""

from __future__ import annotations

import contextlib
import itertools
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import BinaryIO

import msgspec
from mcap.records import Channel, Message, Metadata, Schema

from ltv_mpc.errors import ConfigError
from services.recording.records import Loss, Records, start_of
from services.recording.writer import RUN, open_mcap

RECOVERY = "recovery"
"""Name of the metadata record."""

_NUMBERED = re.compile(r"(.+)\.(\d+)")


class RecoveredSegment(msgspec.Struct, frozen=True, kw_only=True):
    """Segment that was recovered."""

    file: str
    size_bytes: int
    messages: int
    whole: bool
    lost_bytes: int
    orphans: int  # messages whose channel record is lost
    losses: tuple[Loss, ...]


class Recovery(msgspec.Struct, frozen=True, kw_only=True):
    """Result of a recovery."""

    file: str
    messages: int
    lost_bytes: int
    segments: tuple[RecoveredSegment, ...]


def segments(recording: Path) -> tuple[Path, ...]:
    """Return the recording and the segments of restarted recorders that exist: run.mcap, run.2.mcap, ..."""
    numbered = ((_NUMBERED.fullmatch(path.stem), path) for path in recording.parent.glob("*.mcap"))
    found = [(int(match[2]), path) for match, path in numbered if match is not None and match[1] == recording.stem]
    return (recording, *(path for _, path in sorted(found)))


def recovered_path(recording: Path) -> Path:
    """Return the path of a recovered recording: run.recovered.mcap beside run.mcap."""
    return recording.with_name(f"{recording.stem}.recovered.mcap")


def is_whole(recording: Path) -> bool:
    """Return True if the file is complete and undamaged. Raises ``ConfigError`` if it is not an MCAP file."""
    records = Records(recording)
    for _ in records:
        pass
    return records.whole


def recover(parts: Sequence[Path], out: Path) -> Recovery:
    """Copy every complete message of the segments, in their order, into ``out``.

    Raises ``ConfigError`` if ``out`` exists already, a segment is not an MCAP file, or there is no complete message.
    """
    try:
        file = out.open("xb")
    except FileExistsError:
        raise ConfigError(f"recovery {out}", "", "exists: name another with --out") from None
    except ValueError as error:  # a NUL in the name
        raise ConfigError(f"recovery {out}", "", str(error)) from None
    try:
        with file:
            recovery = _Copy(file).run(parts, out)
        if not recovery.messages:
            raise ConfigError(f"recording {parts[0]}", "", "holds no complete message: nothing can be recovered")
    except BaseException:
        out.unlink()
        raise
    return recovery


def next_segment(recording: Path) -> Path:
    """Return the file that a recorder writes: run.mcap, or the next segment if that exists."""
    if not recording.exists():
        return recording
    names = (recording.with_name(f"{recording.stem}.{number}{recording.suffix}") for number in itertools.count(2))
    return next(path for path in names if not path.exists())


def join(recording: Path) -> Iterator[str]:
    """Join the segments into ``recording``. Yield what to report. If joining fails, all files stay as they are."""
    parts = segments(recording)
    if len(parts) == 1:
        return
    draft = recording.with_name(f"{recording.stem}.joined.mcap")
    try:
        draft.unlink(missing_ok=True)
        recovery = recover(parts, draft)
        draft.replace(recording)
    except (ConfigError, OSError) as error:
        with contextlib.suppress(OSError):
            draft.unlink(missing_ok=True)
        yield f"{len(parts)} segments of the recording are not joined: {error}"
        return
    for part in parts[1:]:
        part.unlink()
    count = f"{recovery.messages} messages; {recovery.lost_bytes} bytes were damaged"
    yield f"{len(parts)} segments of the recording joined, {count}"


class _Copy:
    """Copy of segments into one file, with each schema and channel once, whatever ids the segments gave them."""

    def __init__(self, file: BinaryIO) -> None:
        self._mcap = open_mcap(file)
        self._schemas: dict[tuple[str, str, bytes], int] = {}
        self._channels: dict[str, int] = {}
        self._start_ns: int | None = None

    def run(self, parts: Sequence[Path], out: Path) -> Recovery:
        recovered = tuple(self._segment(Records(path)) for path in parts)
        recovery = Recovery(
            file=str(out),
            messages=sum(part.messages for part in recovered),
            lost_bytes=sum(part.lost_bytes for part in recovered),
            segments=recovered,
        )
        losses = {part.file: f"{part.messages} messages, {part.lost_bytes} bytes lost" for part in recovered}
        self._mcap.add_metadata(RECOVERY, losses)
        self._mcap.finish()
        return recovery

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
        """Return the shift of this segment's log time to the first segment's, whose metadata are kept."""
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
