"""Altered copies of a recording: messages lost, damaged, duplicated, of another epoch."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import msgspec

from services.bus import wire
from services.recording.reader import Recording, StoredMessage, metadata_of
from services.recording.writer import RunWriter

Plain = dict[str, Any]

Change = Callable[[StoredMessage, Plain], Iterable[Plain]]
"""Function from one message of the file to the messages in its place."""


def messages(recording: Path) -> list[tuple[StoredMessage, Plain]]:
    """Return all messages of a file."""
    return [(stored, msgspec.json.decode(stored.data)) for stored in Recording(recording)]


def rewritten(
    recording: Path,
    out: Path,
    change: Change,
    *,
    spell: Callable[[Plain], bytes] = wire.pack,
    keep_crc: bool = False,
    metadata: dict[str, str] | None = None,
) -> Path:
    """Write ``out`` with every message changed by ``change``, and the CRC of the frame that ``spell`` encodes.

    ``keep_crc``: under the CRC that it had, as if somebody had edited the file. ``metadata``: in place of its own.
    """
    metadata = dict(metadata or metadata_of(recording))
    start_ns = int(metadata.pop("start_ns"))
    with RunWriter(out, start_ns=start_ns, metadata=metadata, flush_s=None) as writer:
        for stored, plain in messages(recording):
            assert stored.kind is not None
            for message in change(stored, plain):
                crc = stored.crc if keep_crc else wire.crc(spell(message))
                writer.write_plain(stored.key, stored.kind, message, stored.t_ns, crc)
    return out


def without(key: str, sequence: int) -> Change:
    """Return a change that loses one message."""
    return lambda stored, plain: [] if (stored.key, plain["sequence"]) == (key, sequence) else [plain]
