"""A recording that a full or failing disk does not end: run.mcap, then run.2.mcap, ... as soon as one can be written.

What the disk refused is cut off behind what it last took, so that every segment can be read to its end; what was in it
and is not is handed back, to be counted. Until a segment can be opened, everything is handed back.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeAlias

from ltv_mpc.messages import Message
from services.recording.join import next_segment
from services.recording.writer import RunWriter

Source: TypeAlias = tuple[str, int]
"""A message's key and epoch."""

RETRY_S = 1.0


class SegmentWriter:
    """Writes the next free segment beside ``recording``; a context manager. Raises ``OSError`` if it cannot begin."""

    def __init__(self, recording: Path, *, start_ns: int, metadata: Mapping[str, str]) -> None:
        self._recording = recording
        self._start_ns, self._metadata = start_ns, metadata
        self._unsafe: list[Source] = []  # since the last flush
        self._refused: list[Source] = []
        self._news: list[str] = []
        self._retry_s = 0.0
        self.resumes = recording.exists()
        """Whether an earlier recorder has left a segment."""
        self._writer: RunWriter | None = self._open()

    def write_plain(self, key: str, kind: type[Message], message: Mapping[str, Any], t_ns: int, crc: int) -> None:
        """As ``RunWriter.write_plain``; what is not kept comes out of ``refused``."""
        writer = self._writer or self._open_again()
        source = (key, message["epoch"])
        if writer is None:
            self._refused.append(source)
            return
        self._unsafe.append(source)
        try:
            writer.write_plain(key, kind, message, t_ns, crc)
        except OSError as error:
            self._give_up(writer, error)
        except BaseException:
            self._unsafe.pop()
            raise
        else:
            self._settle(writer)

    def flush_if_due(self, *, now: bool = False) -> None:
        """To be called also while nothing arrives; ``now``: it is due."""
        writer = self._writer
        if writer is None:
            return
        try:
            writer.flush() if now else writer.flush_if_due()
        except OSError as error:
            self._give_up(writer, error)
        else:
            self._settle(writer)

    def refused(self) -> list[Source]:
        """Of messages that were given and are not in the file, since the last call."""
        refused, self._refused = self._refused, []
        return refused

    def news(self) -> list[str]:
        """What is to be said, since the last call."""
        news, self._news = self._news, []
        return news

    def close(self) -> None:
        """The end of the file. What it does not take shows in ``refused``."""
        writer, self._writer = self._writer, None
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
            writer = RunWriter(path, start_ns=self._start_ns, metadata=self._metadata)
            try:
                writer.flush()
            except OSError:
                writer.abandon()
                raise
        except OSError:
            with contextlib.suppress(OSError):
                path.unlink()  # else each try would leave an empty one
            raise
        return writer

    def _open_again(self) -> RunWriter | None:
        now_s = time.monotonic()
        if now_s < self._retry_s:
            return None
        self._retry_s = now_s + RETRY_S
        try:
            self._writer = self._open()
        except OSError:
            return None
        self._news.append(f"recording continues in {self._writer.path.name}")
        return self._writer

    def _settle(self, writer: RunWriter) -> None:
        if writer.unsafe == 0:
            self._unsafe.clear()

    def _give_up(self, writer: RunWriter, error: OSError) -> None:
        """The segment ends where the disk last took something."""
        writer.abandon()
        self._writer = None
        self._retry_s = time.monotonic() + RETRY_S
        self._refused += self._unsafe
        self._news.append(f"not recording: {error.strerror}; {len(self._unsafe)} messages not recorded so far")
        self._unsafe.clear()
