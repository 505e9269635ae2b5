"""Joining of recording segments: one recording from those that restarted recorders have left."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Iterator
from pathlib import Path

from ltv_mpc.errors import ConfigError
from services.recording.recover import recover, segments


def next_segment(recording: Path) -> Path:
    """Return the file that a recorder writes: run.mcap, or the next segment if that exists."""
    if not recording.exists():
        return recording
    names = (recording.with_name(f"{recording.stem}.{number}{recording.suffix}") for number in itertools.count(2))
    return next(path for path in names if not path.exists())


def segments_of(recording: Path) -> Iterator[str]:
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
