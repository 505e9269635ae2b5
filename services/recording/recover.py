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

import msgspec

from ltv_mpc.errors import ConfigError
from services.recording.reader import Recording, metadata_of
from services.recording.records import Loss, Records, start_of
from services.recording.writer import RunWriter

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
        out.open("xb").close()
    except FileExistsError:
        raise ConfigError(f"recovery {out}", "", "exists: name another with --out") from None
    except ValueError as error:  # a NUL in the name
        raise ConfigError(f"recovery {out}", "", str(error)) from None
    try:
        recovery = _copied(parts, out)
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


def _copied(parts: Sequence[Path], out: Path) -> Recovery:
    """Copy the messages of the segments into ``out``, with the metadata of the first one that has any."""
    metadata = next((found for found in map(metadata_of, parts) if found), {})
    copied = []
    with RunWriter(out, start_ns=start_of(metadata), metadata=metadata, flush_s=None) as writer:
        for path in parts:
            recording, messages = Recording(path), 0
            for stored in recording.stored():
                writer.copy(stored, *recording.channels[stored.key])
                messages += 1
            for name, values in recording.others.items():
                writer.add_metadata(name, values)
            (records,) = recording.parts
            segment = RecoveredSegment(
                file=path.name,
                size_bytes=records.size,
                messages=messages,
                whole=records.whole,
                lost_bytes=records.lost_bytes,
                orphans=records.orphans,
                losses=tuple(records.losses),
            )
            copied.append(segment)
        losses = {part.file: f"{part.messages} messages, {part.lost_bytes} bytes lost" for part in copied}
        writer.add_metadata(RECOVERY, losses)
    return Recovery(
        file=str(out),
        messages=sum(part.messages for part in copied),
        lost_bytes=sum(part.lost_bytes for part in copied),
        segments=tuple(copied),
    )
