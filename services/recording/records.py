"""Records of an MCAP file, read sequentially, also if the file is truncated or damaged.

    file    magic, records, magic
    record  opcode (u8), length (u64), content; little-endian throughout
    chunk   a record whose content is compressed records, with their CRC-32

If its writer was killed, a file is truncated: everything before that place is read, of a chunk that is cut what its
complete blocks (zstd: 128 KiB) decompress to, without its CRC. Else the unit of loss is a chunk, because a wrong CRC
does not tell which byte of it is wrong. Memory is bounded by ``LARGE_BYTES`` or ``LARGE_RATIO`` times the largest
record, whatever lengths the file claims.

Source: https://mcap.dev/spec
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple, TypeAlias

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message, Metadata, Schema

from ltv_mpc.config import open_file
from ltv_mpc.errors import ConfigError
from services.bus.topics import topic_at

MAGIC = b"\x89MCAP0\r\n"
MAX_RATIO, FREE_BYTES = 200, 1 << 14
"""Limit of a chunk's compression, and size below which it does not hold: messages are compressed to a tenth."""
LARGE_RATIO, LARGE_BYTES = 20, 1 << 25
"""The same limit of a chunk above this size: ours have 1 MiB plus one message, others may put all into one chunk."""
MAX_TABLE = 10_000
"""Number of channels and schemas of a file that are read."""

ENCODING, OWN = "json", "ltv_mpc."
"""Encoding of our messages, and the begin of the names of their schemas."""
FOREIGN = (
    "was not written by `ltv-mpc recorder`. A bag of ROS 2: play it, with `ltv-mpc ros2` and the recorder beside it."
)

_HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")

NAMES = {int(opcode): opcode.name.lower().replace("_", " ") for opcode in Opcode}
KINDS: dict[int, type[Channel | Schema | Metadata]] = {
    Opcode.CHANNEL: Channel, Opcode.SCHEMA: Schema, Opcode.METADATA: Metadata
}  # fmt: skip
IN_CHUNK = frozenset(map(int, (Opcode.MESSAGE, Opcode.CHANNEL, Opcode.SCHEMA)))

DECODING_ERRORS = (McapError, ValueError, OverflowError, struct.error, zstandard.ZstdError, RuntimeError, MemoryError)
"""Exceptions of mcap, zstd, lz4 and struct on damaged content; UnicodeDecodeError is a ValueError."""

Record: TypeAlias = Schema | Channel | Message | Metadata

_progress: ContextVar[Callable[[float], None] | None] = ContextVar("progress of reading", default=None)


@contextmanager
def report_progress(callback: Callable[[float], None]) -> Iterator[None]:
    """Report the share of a file that is read, 0 to 1, for all reading within the context."""
    before = _progress.set(callback)
    try:
        yield
    finally:
        _progress.reset(before)


def start_of(metadata: dict[str, str]) -> int:
    """Return the vehicle time (ns) of log time 0; 0 if the metadata do not have it."""
    text = metadata.get("start_ns", "0")
    return int(text) if re.fullmatch(r"-?\d{1,19}", text) else 0


class Loss(NamedTuple):
    """Bytes of the file that could not be read."""

    offset: int
    length: int
    why: str


class Records:
    """Schemas, channels, messages and metadata of a file, in its order; a channel comes before its messages.

    After iteration, ``losses`` lists the unreadable bytes, and ``orphans`` counts the messages that were skipped
    because the record of their channel is lost. ``position`` is the place of the newest record, of ``size`` bytes.
    Iteration raises ``ConfigError`` if the file is not an MCAP file, or one of another program. An empty file has no
    records and is not whole.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.size = 0
        self.position = 0
        self.losses: list[Loss] = []
        self.orphans = 0
        self.finished = False
        self.grows: Callable[[], bool] = lambda: False
        """Called at the end of what there is: waits, and says whether to look for more."""
        self.schemas: dict[int, Schema] = {}
        """Those that have been read, by their ids."""
        self._channels: set[int] = set()

    @property
    def whole(self) -> bool:
        """True if the file is complete and nothing is lost."""
        return self.finished and not self.losses and not self.orphans

    @property
    def lost_bytes(self) -> int:
        """Number of unreadable bytes."""
        return sum(loss.length for loss in self.losses)

    def __iter__(self) -> Iterator[Record]:
        self.losses, self.orphans, self.finished = [], 0, False
        self._channels.clear()
        with open_file(self.path, what="recording") as file:
            self.size = file.seek(0, 2)
            file.seek(0)
            if file.read(len(MAGIC)) != MAGIC[: self.size]:
                raise ConfigError(f"recording {self.path}", "", "not an MCAP file")
            yield from self._records(file)  # none, if the writer was killed before the first record

    def _records(self, file: BinaryIO) -> Iterator[Record]:
        summary = False  # the records behind DataEnd repeat earlier ones
        callback = _progress.get()
        while True:
            start = self.position = file.tell()
            if callback is not None:
                callback(start / max(self.size, 1))
            head = file.read(_HEAD.size)
            opcode, length = _HEAD.unpack(head) if len(head) == _HEAD.size else (0, 0)
            if len(head) < _HEAD.size or file.tell() + length > self.size:
                if self.grows():
                    self.size = file.seek(0, 2)
                    file.seek(start)
                    continue
                if head:
                    what = f"a record of {length} bytes" if length else "the head of a record"
                    if opcode == Opcode.CHUNK:
                        there = list(filter(self._is_known, _cut_chunk(file.read())))
                        yield from there
                        what = f"a chunk of {length} bytes, of which the first {len(there)} records are read"
                    self._lose(start, self.size - start, f"cut in {what}")
                return
            content = file.read(length)
            if opcode == Opcode.FOOTER:
                self._end(file)
                return
            if opcode == Opcode.DATA_END:
                summary = True
            elif not summary:
                try:
                    found = list(_decoded(opcode, content))
                except DECODING_ERRORS as error:
                    why = " ".join(str(error).split()) or type(error).__name__
                    self._lose(start, _HEAD.size + length, f"{NAMES.get(opcode, f'record {opcode}')}: {why}"[:200])
                else:
                    yield from filter(self._is_known, found)

    def _end(self, file: BinaryIO) -> None:
        rest = file.read()
        self.finished = rest.startswith(MAGIC)
        if rest != MAGIC:
            what = "bytes behind the end of the MCAP file" if self.finished else "the end of the MCAP file is missing"
            self._lose(self.size - len(rest), len(rest), what)

    def _lose(self, offset: int, length: int, why: str) -> None:
        self.losses.append(Loss(offset, length, why))

    def _is_known(self, record: Record) -> bool:
        """Return False for a message of a lost channel. Raises ``ConfigError`` if the first is of another program."""
        if len(self.schemas) + len(self._channels) > MAX_TABLE:
            raise ConfigError(f"recording {self.path}", "", f"more than {MAX_TABLE} channels and schemas")
        if isinstance(record, Message):
            known = record.channel_id in self._channels
            self.orphans += not known
            return known
        if isinstance(record, Schema):
            self.schemas[record.id] = record
        elif isinstance(record, Channel):
            schema = found.name if (found := self.schemas.get(record.schema_id)) else ""
            ours = schema.startswith(OWN) or not schema or topic_at(record.topic) is not None
            if (record.message_encoding != ENCODING or not ours) and not self._channels:
                what = f"{record.topic}, {schema} as {record.message_encoding}"
                raise ConfigError(f"recording {self.path}", "", f"{FOREIGN} It has {what}"[:300])
            self._channels.add(record.id)
        return True


def _decoded(opcode: int, content: bytes) -> Iterable[Record]:
    """Return the records that a record contains."""
    if opcode == Opcode.MESSAGE:
        return (_message(content),)
    stream = ReadDataStream(BytesIO(content))
    if opcode == Opcode.CHUNK:
        return _in_chunk(Chunk.read(stream))
    kind = KINDS.get(opcode)  # None: an index, or a record of a later version
    return () if kind is None else (kind.read(stream),)


def _in_chunk(chunk: Chunk, *, cut: bool = False) -> Iterator[Record]:
    """Yield the records of a chunk, of one that is ``cut`` until an incomplete one.

    Raises ``ValueError`` if its CRC is wrong or it holds others than a chunk can. mcap reads a message in eight calls,
    which takes five times as long, and skips other records one by one.
    """
    data, start = _decompressed(chunk, cut=cut), 0
    if not cut and chunk.uncompressed_crc not in (0, zlib.crc32(data)):
        raise ValueError("wrong CRC")
    while start < len(data):
        opcode, length = _HEAD.unpack_from(data, start)
        start += _HEAD.size
        end = start + length
        if end > len(data) or opcode not in IN_CHUNK:
            raise ValueError("a record type that a chunk cannot hold")
        yield from _decoded(opcode, data[start:end])
        start = end


def _cut_chunk(content: bytes) -> Iterator[Record]:
    """Yield the records of a chunk that is cut, as far as they can be decompressed."""
    with suppress(*DECODING_ERRORS):
        yield from _in_chunk(Chunk.read(ReadDataStream(BytesIO(content))), cut=True)


def _message(content: bytes) -> Message:
    channel, sequence, log_time, publish_time = _MESSAGE.unpack_from(content)
    return Message(channel, log_time, content[_MESSAGE.size :], publish_time, sequence)


def _decompressed(chunk: Chunk, *, cut: bool) -> bytes:
    """Return the content of a chunk; of one that is ``cut``, what is there.

    Raises ``ValueError`` if it claims too much.
    """
    data: bytes = chunk.data
    size, stored = chunk.uncompressed_size, len(data)
    if cut:
        size = min(size, FREE_BYTES + LARGE_RATIO * stored)
    ratio = LARGE_RATIO if size > LARGE_BYTES else MAX_RATIO
    if size > FREE_BYTES + ratio * stored:
        raise ValueError(f"{size} bytes from {stored}: more than {ratio} times as many")
    match chunk.compression:
        case "lz4":  # mcap would let the frame grow without limit
            data = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size)
        case "zstd" if cut:
            data = zstandard.ZstdDecompressor(max_window_size=LARGE_BYTES).stream_reader(data).read(size)
        case "zstd":
            # The frame claims a size of its own, which zstd would trust.
            if zstandard.frame_content_size(data) > size:
                raise ValueError("its zstd frame claims too many bytes")
            data = zstandard.decompress(data, size)
        case other if other:
            raise ValueError(f"compressed by {other[:20]!r}, which is not supported")
    return data
