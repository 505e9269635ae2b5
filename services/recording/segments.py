"""Recording in segments, which continues after a disk error: run.mcap, then run.2.mcap, ...

After a write error the segment is truncated to its last successful flush, so that it can be read to its end. Messages
that are lost by that, and all messages until the next segment can be opened, are counted.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from ltv_mpc.messages import Message
from services.recording.history import History
from services.recording.recover import next_segment
from services.recording.writer import RunWriter

RETRY_S = 1.0


class SegmentWriter:
    """Writer of the next free segment beside ``recording``; a context manager.

    Raises ``OSError`` if the first segment cannot be opened.
    """

    def __init__(self, recording: Path, *, start_ns: int, metadata: Mapping[str, str]) -> None:
        self._recording = recording
        self._start_ns, self._metadata = start_ns, metadata
        self.lost = 0
        """Number of messages that are not in the file, because the disk did not take them."""
        self._unsafe = 0  # messages since the last flush
        self._news: list[str] = []
        self._retry_s = 0.0  # monotonic time of the next attempt
        self.history = History()
        """Decimated history of what was recorded, for pages that join late."""
        self.resumes = recording.exists()
        """True if an earlier recorder has left a segment."""
        self.segment: RunWriter | None = self._open()
        """Writer of the open segment; None while none can be opened."""

    def write_plain(self, key: str, kind: type[Message], message: Mapping[str, Any], t_ns: int, crc: int) -> None:
        """Write a message, as ``RunWriter.write_plain``. One that cannot be kept is counted as lost."""
        self.history.add(key, kind, message)
        writer = self.segment or self._reopen()
        if writer is None:
            self.lost += 1
            return
        self._unsafe += 1
        self._attempt(writer, lambda: writer.write_plain(key, kind, message, t_ns, crc))

    def flush_if_due(self, *, now: bool = False) -> None:
        """Flush if it is due, or ``now``. Must also be called while no messages arrive."""
        if (writer := self.segment) is not None:
            self._attempt(writer, lambda: writer.flush_if_due(now=now))

    def news(self) -> list[str]:
        """Return the reports for the user since the last call."""
        news, self._news = self._news, []
        return news

    def close(self) -> None:
        """Finish the file. Messages that the disk does not take are counted as lost."""
        writer, self.segment = self.segment, None
        if writer is not None:
            self._attempt(writer, writer.close)
            self._unsafe = 0

    def __enter__(self) -> SegmentWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _open(self) -> RunWriter:
        path = next_segment(self._recording)
        try:
            return RunWriter(path, start_ns=self._start_ns, metadata=self._metadata)
        except OSError:
            with contextlib.suppress(OSError):
                path.unlink()  # otherwise each attempt would leave an empty file
            raise

    def _reopen(self) -> RunWriter | None:
        now_s = time.monotonic()
        if now_s < self._retry_s:
            return None
        self._retry_s = now_s + RETRY_S
        try:
            self.segment = self._open()
        except OSError:
            return None
        self._news.append(f"recording continues in {self.segment.path.name}")
        return self.segment

    def _attempt(self, writer: RunWriter, write: Callable[[], bool | None]) -> None:
        """Write to a segment. After an error it ends at its last successful flush; the next one is tried later."""
        try:
            if write():
                self._unsafe = 0
        except OSError as error:
            writer.abandon()
            self.segment = None
            self._retry_s = time.monotonic() + RETRY_S
            self.lost += self._unsafe
            self._news.append(f"not recording: {error.strerror}; {self._unsafe} messages not recorded so far")
            self._unsafe = 0
