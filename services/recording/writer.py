"""Writer of a run's recording: run.mcap, which Foxglove and every MCAP library can open.

    channel      one for each key; JSON messages with a JSON schema: the plain map of a frame (``services/bus/wire.py``)
    sequence     CRC-32 of the frame as received, by which a step record finds it; MCAP gives the field no meaning
    log_time     = publish_time = vehicle time of publication minus the run's start (ns); MCAP has no negative times
    metadata     record ``run`` at the start of the file, where a truncated file has it too: settings and versions

The header's own sequence number is in the message. Chunks have at most 1 MiB and are flushed at least every half second
of wall time, so that a SIGKILL costs little. In lock step nothing is flushed by the wall clock: the file depends on its
messages alone, byte for byte. MCAP's writer keeps its index in memory until the end: 1.6 kB for each chunk, 11 MB an
hour at two chunks a second (docs/notes/libraries.md).
"""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
from mcap.records import Channel, Schema
from mcap.writer import CompressionType, Writer

from ltv_mpc.messages import Message
from services.bus import schema, topics, wire
from services.recording.records import ENCODING, OWN

if TYPE_CHECKING:
    from services.recording.reader import StoredMessage

CHUNK_BYTES = 1024 * 1024
FLUSH_S = 0.5
PROFILE = ""  # of MCAP: none of the registered ones
LIBRARY = "ltv-mpc"
RUN = "run"
"""Name of the metadata record."""
VEHICLE_MODE = "vehicle"
"""Entry ``mode`` of a recording beside a vehicle; its times are those of the vehicle's own clock."""
MAX_LOG_TIME = 2**64 - 1
ENDED = "ended"
"""Kind of the supervisor's event that says why a run ended early."""


class RunWriter:
    """Writer of one file; a context manager. ``flush_s``: longest interval between flushes; None: by size alone."""

    def __init__(
        self, path: Path, *, start_ns: int, metadata: Mapping[str, str], flush_s: float | None = FLUSH_S
    ) -> None:
        self.path = path
        self._start_ns = start_ns
        self.flush_s = flush_s
        self._channels: dict[str, int] = {}
        self._schemas: dict[tuple[str | bytes, ...], int] = {}
        self.file = path.open("wb")
        try:
            # Any: the package does not annotate all of its methods
            self._mcap: Any = Writer(self.file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
            self._mcap.start(PROFILE, LIBRARY)
            self.add_metadata(RUN, {"start_ns": str(start_ns), **metadata})
            self.flush()
        except OSError:  # a full disk
            self._close()
            raise

    def write(self, writer: str, message: Message, header: wire.Header, t_ns: int) -> None:
        """Write a message that node ``writer`` published at vehicle time ``t_ns``."""
        self.write_plain(topics.key_of(type(message), writer), type(message), wire.to_map(message, header), t_ns)

    def write_plain(
        self, key: str, kind: type[Message], message: Mapping[str, Any], t_ns: int, crc: int | None = None
    ) -> bool:
        """Write a plain message: ``wire.unpack`` of its payload. Raises ``WireError`` if JSON cannot represent it.

        ``crc`` is that of the payload; None: that of our own encoder's payload. Return True if it is flushed.
        """
        try:
            data = msgspec.json.encode(message)
            crc = wire.crc(wire.pack(message)) if crc is None else crc
        except (TypeError, ValueError, RecursionError) as error:
            raise wire.WireError(f"not a plain map: {error}") from None
        if key not in self._channels:
            self._register(key, ENCODING, f"{OWN}{kind.__name__}", "jsonschema", schema.text(kind))
        self._add(key, t_ns, data, crc)
        return self.flush_if_due()

    def copy(self, stored: StoredMessage, channel: Channel, of: Schema | None) -> None:
        """Write a message of another file byte for byte, on a channel as there."""
        if stored.key not in self._channels:
            described = () if of is None else (of.name, of.encoding, of.data)
            self._register(stored.key, channel.message_encoding, *described)
        self._add(stored.key, stored.t_ns, stored.data, stored.crc)

    def add_metadata(self, name: str, metadata: Mapping[str, str]) -> None:
        """Write a metadata record."""
        self._mcap.add_metadata(name, metadata)

    def flush_if_due(self, *, now: bool = False) -> bool:
        """Flush if ``flush_s`` has passed, or ``now``; return True then. To be called also while no messages arrive."""
        due = now or (self.flush_s is not None and time.monotonic() - self._flushed_at >= self.flush_s)
        if due:
            self.flush()
        return due

    def flush(self) -> None:
        """Pass all messages so far to the operating system."""
        self._mcap.flush()
        self._flushed_bytes = self.file.tell()
        self._flushed_at = time.monotonic()

    def abandon(self) -> None:
        """Truncate the file to its last flush and close it without an index, after an ``OSError``."""
        with contextlib.suppress(OSError):
            os.truncate(self.path, self._flushed_bytes)
        self._close()

    def close(self) -> None:
        """Write the index and the end of the file, and close it."""
        if not self.file.closed:
            try:
                self._mcap.finish()
                self.file.flush()
            finally:
                self._close()

    def __enter__(self) -> RunWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _close(self) -> None:
        with contextlib.suppress(OSError):  # a full disk does not take the rest of the buffer
            self.file.close()

    def _register(self, key: str, encoding: str, *described: str | bytes) -> None:
        """Register the channel of a key; ``described``: name, encoding and text of its schema, if it has one."""
        if described and described not in self._schemas:
            self._schemas[described] = self._mcap.register_schema(*described)
        self._channels[key] = self._mcap.register_channel(key, encoding, self._schemas.get(described, 0))

    def _add(self, key: str, t_ns: int, data: bytes, crc: int) -> None:
        log_time = min(max(0, t_ns - self._start_ns), MAX_LOG_TIME)
        self._mcap.add_message(self._channels[key], log_time, data, log_time, crc)
