"""Small synthetic recordings, which tests truncate, damage, count and convert."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import zstandard
from mcap.reader import make_reader
from mcap.writer import Writer

from ltv_mpc.messages import Message, PressureDepth
from services.bus.wire import Header
from services.recording.reader import Recording
from services.recording.writer import RunWriter

START_NS = -1_000_000_000


def depth(i: int) -> PressureDepth:
    return PressureDepth(t_ns=START_NS + i * 1_000_000, depth_m=i / 7)


A_CHUNK = 300
"""Messages of a chunk: each flush ends one, as each half second does with the wall clock."""


def write(
    path: Path, messages: Iterable[tuple[str, Message, int, int, int]], *, start_ns: int = START_NS, **metadata: str
) -> Path:
    """Write ``messages``: writer, message, epoch, sequence number, vehicle time of publication."""
    with RunWriter(path, start_ns=start_ns, metadata=metadata, flush_s=None) as writer:
        for i, (node, signal, epoch, sequence, t_ns) in enumerate(messages):
            writer.write(node, signal, Header(epoch=epoch, sequence=sequence), t_ns)
            if i % A_CHUNK == A_CHUNK - 1:
                writer.flush()
    return path


def foreign(path: Path, key: str, *messages: bytes, **metadata: str) -> Path:
    """Write a foreign recording: any bytes as messages of a key, with correct checksums."""
    return foreign_keys(path, (key,), *messages, **metadata)


def foreign_keys(path: Path, keys: Iterable[str], *messages: bytes, **metadata: str) -> Path:
    """Write the same messages, any bytes, on each of the keys."""
    with path.open("wb") as file:
        writer: Any = Writer(file)
        writer.start()
        writer.add_metadata("run", metadata)
        for key in keys:
            channel = writer.register_channel(key, "json", 0)
            for message in messages:
                writer.add_message(channel, 0, message, 0)
        writer.finish()
    return path


def write_depths(path: Path, sequences: Iterable[int], *, epoch: int = 1, start_ns: int = START_NS) -> Path:
    """Write one key; ``depth(i)`` has the sequence number ``i``."""
    messages = (("sensors", depth(i), epoch, i, depth(i).t_ns) for i in sequences)
    return write(path, messages, start_ns=start_ns, seed="7")


def sequences(path: Path) -> list[int]:
    """Return the sequence numbers in a file, in its order."""
    return [message.plain["sequence"] for message in Recording(path)]


def chunks(path: Path) -> list[tuple[int, int, int]]:
    """Return offset, length and number of messages of each chunk, from mcap's own index."""
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    logged = [message.t_ns - START_NS for message in Recording(path)]
    return [
        (
            index.chunk_start_offset,
            index.chunk_length,
            sum(index.message_start_time <= at <= index.message_end_time for at in logged),
        )
        for index in summary.chunk_indexes
    ]


def text(value: bytes) -> bytes:
    """Return a text as MCAP writes it."""
    return struct.pack("<I", len(value)) + value


def record(opcode: int, content: bytes, *, claimed: int | None = None) -> bytes:
    """Return a record of MCAP, which may claim another length."""
    return struct.pack("<BQ", opcode, len(content) if claimed is None else claimed) + content


def chunk(data: bytes, *, size: int | None = None, compressed: bytes | None = None, by: bytes = b"zstd") -> bytes:
    """Return a chunk of MCAP, which may claim another size, or hold something else than ``data``."""
    packed = zstandard.compress(data) if compressed is None else compressed
    head = struct.pack("<QQQI", 0, 0, len(data) if size is None else size, zlib.crc32(data))
    return record(6, head + text(by) + struct.pack("<Q", len(packed)) + packed)
