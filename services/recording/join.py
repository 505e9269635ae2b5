"""The segments that restarted recorders have left, made into the one recording that a run is read from."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Iterator
from pathlib import Path

from ltv_mpc.errors import ConfigError
from services.recording.recover import recover, segments


def next_segment(recording: Path) -> Path:
    """Where a recorder writes: run.mcap, or what follows the segments that are there."""
    if not recording.exists():
        return recording
    names = (recording.with_name(f"{recording.stem}.{number}{recording.suffix}") for number in itertools.count(2))
    return next(path for path in names if not path.exists())


def segments_of(recording: Path) -> Iterator[str]:
    """Join what is there into ``recording``; what is to be said of it. Where that fails everything stays as it is."""
    parts = segments(recording)
    if len(parts) == 1:
        return
    draft = recording.with_name(f"{recording.stem}.joined.mcap")
    try:
        draft.unlink(missing_ok=True)
        made = recover(parts, draft)
        draft.replace(recording)
    except (ConfigError, OSError) as error:
        with contextlib.suppress(OSError):
            draft.unlink(missing_ok=True)
        yield f"{len(parts)} segments of the recording are not joined: {error}"
        return
    for part in parts[1:]:
        part.unlink()
    yield f"{len(parts)} segments of the recording joined, {made.messages} messages; {made.lost_bytes} bytes lost"
