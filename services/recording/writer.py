"""A run's recording: run.mcap, which Foxglove and every MCAP library open.

One channel a key, JSON messages with a JSON schema; a message is the plain map that travels (``services/bus/wire.py``).
MCAP's ``sequence``, 32 bits without a meaning of their own there, is the CRC-32 of the frame as it was received: what a
step record finds it by, however its sender spelled it (the header's own ``sequence`` is in the message). MCAP knows no
negative times: ``log_time`` = ``publish_time`` = vehicle time of publication minus the run's start, ns. What the run
was made of stands in the metadata record ``run``, at the head of the file, where a cut file has it too.

Chunks have at most 1 MiB and are flushed at least every half second of wall time, so that a SIGKILL costs little. In
lock step nothing is flushed by the wall clock: the file is a function of its messages, byte for byte. MCAP's writer
keeps its index in memory until it writes it at the end: 1.6 kB a chunk, 11 MB an hour at two chunks a second
(docs/notes/libraries.md).
"""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
from mcap.writer import CompressionType, Writer

from ltv_mpc.messages import Message
from services.bus import schema, topics, wire

CHUNK_BYTES = 1024 * 1024
FLUSH_S = 0.5
PROFILE = ""  # of MCAP: none of the registered ones
LIBRARY = "ltv-mpc"
RUN = "run"
"""Name of the metadata record."""


class RunWriter:
    """Writes ``path``; a context manager. ``flush_s`` None: by size alone."""

    def __init__(
        self, path: Path, *, start_ns: int, metadata: Mapping[str, str], flush_s: float | None = FLUSH_S
    ) -> None:
        self.path = path
        self.messages = 0
        self._safe = 0, 0  # bytes and messages that were flushed
        self._start_ns = start_ns
        self._flush_s = flush_s
        self._flushed_at = time.monotonic()
        self._channels: dict[str, int] = {}
        self._schemas: dict[type[Message], int] = {}
        self._file = path.open("wb")
        # Any: the package leaves the types of some of its methods out.
        self._mcap: Any = Writer(self._file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        try:
            self._mcap.start(PROFILE, LIBRARY)
            self._mcap.add_metadata(RUN, {"start_ns": str(start_ns), **metadata})
        except OSError:  # a full disk
            self._close()
            raise

    def write(self, writer: str, signal: Message, header: wire.Header, t_ns: int) -> None:
        """A signal that node ``writer`` published at vehicle time ``t_ns``."""
        self.write_plain(topics.key_of(type(signal), writer), type(signal), wire.to_map(signal, header), t_ns)

    def write_plain(
        self, key: str, kind: type[Message], message: Mapping[str, Any], t_ns: int, crc: int | None = None
    ) -> None:
        """A message as it travelled: ``wire.unpack`` of its payload. Raises ``WireError`` where JSON cannot hold it.

        ``crc``: of the payload; None: it is spelled as our own encoder does.
        """
        log_time = max(0, t_ns - self._start_ns)
        try:
            data = msgspec.json.encode(message)
            crc = wire.crc(wire.pack(message)) if crc is None else crc
        except (TypeError, ValueError, RecursionError) as error:
            raise wire.WireError(f"not a plain map: {error}") from None
        channel = self._channels.get(key)
        if channel is None:
            channel = self._register(key, kind)
        self._mcap.add_message(channel, log_time, data, log_time, crc)
        self.messages += 1
        self.flush_if_due()

    def flush_if_due(self) -> None:
        """To be called also while nothing arrives."""
        if self._flush_s is not None and time.monotonic() - self._flushed_at >= self._flush_s:
            self.flush()

    def flush(self) -> None:
        """Everything so far to the operating system."""
        self._mcap.flush()
        self._safe = self._file.tell(), self.messages
        self._flushed_at = time.monotonic()

    @property
    def unsafe(self) -> int:
        """How many messages a failing disk would cost now."""
        return self.messages - self._safe[1]

    def abandon(self) -> None:
        """After an ``OSError``: cut off what was not flushed, and close without an end."""
        with contextlib.suppress(OSError):
            os.truncate(self.path, self._safe[0])
        self._close()

    def close(self) -> None:
        """The index, and the end of the file."""
        if not self._file.closed:
            try:
                self._mcap.finish()
                self._file.flush()
            finally:
                self._close()

    def __enter__(self) -> RunWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _close(self) -> None:
        with contextlib.suppress(OSError):  # a full disk does not take what a buffer still has
            self._file.close()

    def _register(self, key: str, kind: type[Message]) -> int:
        if kind not in self._schemas:
            name = f"ltv_mpc.{kind.__name__}"
            self._schemas[kind] = self._mcap.register_schema(name, "jsonschema", schema.text(kind))
        channel: int = self._mcap.register_channel(key, "json", self._schemas[kind])
        self._channels[key] = channel
        return channel
