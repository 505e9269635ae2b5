"""Recording in segments, which continues after a disk error: run.mcap, then run.2.mcap, ...

After a write error the segment is truncated to its last successful flush, so that it can be read to its end. Messages
that are lost by that, and all messages until the next segment can be opened, are returned by ``refused`` and counted.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeAlias

from ltv_mpc.messages import Message
from services.recording.history import History
from services.recording.recover import next_segment
from services.recording.writer import RunWriter

Source: TypeAlias = tuple[str, int]
"""A message's key and epoch."""

RETRY_S = 1.0


class SegmentWriter:
    """Writer of the next free segment beside ``recording``; a context manager.

    Raises ``OSError`` if the first segment cannot be opened.
    """

    def __init__(
        self,
        recording: Path,
        *,
        start_ns: int,
        metadata: Mapping[str, str],
        retry_s: float = RETRY_S,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._recording = recording
        self._start_ns, self._metadata = start_ns, metadata
        self._unsafe: list[Source] = []  # sources of the messages since the last flush
        self._refused: list[Source] = []
        self._news: list[str] = []
        self._retry_period_s, self._clock = retry_s, clock
        self._retry_s = 0.0  # monotonic time of the next attempt
        self.history = History()
        """Decimated history of what was recorded, for pages that join late."""
        self.resumes = recording.exists()
        """True if an earlier recorder has left a segment."""
        self.segment: RunWriter | None = self._open()
        """Writer of the open segment; None while none can be opened."""

    def write_plain(self, key: str, kind: type[Message], message: Mapping[str, Any], t_ns: int, crc: int) -> None:
        """Write a message, as ``RunWriter.write_plain``. If it cannot be kept, ``refused`` returns it."""
        self.history.add(key, kind, message)
        writer = self.segment or self._reopen()
        source = (key, message["epoch"])
        if writer is None:
            self._refused.append(source)
            return
        try:
            flushed = writer.write_plain(key, kind, message, t_ns, crc)
        except OSError as error:
            self._unsafe.append(source)
            self._give_up(writer, error)
        else:
            self._unsafe.append(source)
            if flushed:
                self._unsafe.clear()

    def flush_if_due(self, *, now: bool = False) -> None:
        """Flush if it is due, or ``now``. Must also be called while no messages arrive."""
        writer = self.segment
        if writer is None:
            return
        try:
            if writer.flush_if_due(now=now):
                self._unsafe.clear()
        except OSError as error:
            self._give_up(writer, error)

    def refused(self) -> list[Source]:
        """Return the sources of the messages since the last call that are not in the file."""
        refused, self._refused = self._refused, []
        return refused

    def news(self) -> list[str]:
        """Return the reports for the user since the last call."""
        news, self._news = self._news, []
        return news

    def close(self) -> None:
        """Finish the file. Messages that the disk does not take are returned by ``refused``."""
        writer, self.segment = self.segment, None
        if writer is None:
            return
        try:
            writer.close()
        except OSError as error:
            self._give_up(writer, error)
        self._unsafe.clear()

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
        now_s = self._clock()
        if now_s < self._retry_s:
            return None
        self._retry_s = now_s + self._retry_period_s
        try:
            self.segment = self._open()
        except OSError:
            return None
        self._news.append(f"recording continues in {self.segment.path.name}")
        return self.segment

    def _give_up(self, writer: RunWriter, error: OSError) -> None:
        """Truncate the segment to its last successful flush, and retry later with the next one."""
        writer.abandon()
        self.segment = None
        self._retry_s = self._clock() + self._retry_period_s
        self._refused += self._unsafe
        self._news.append(f"not recording: {error.strerror}; {len(self._unsafe)} messages not recorded so far")
        self._unsafe.clear()
