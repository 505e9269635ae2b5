"""The records of an MCAP file, one by one from its front, whatever its bytes are: whole, cut or damaged.

    file    magic, records, magic
    record  opcode (u8), length (u64), content; little-endian throughout
    chunk   a record whose content is compressed records, with their CRC-32

A file ends in its middle where its writer was killed: what is whole before that place is given. A chunk is the unit of
what can be lost: zstd gives nothing of a compressed block that is not complete, and a wrong CRC says that something in
it is wrong, not what. Memory is bounded by the largest record and by ``MAX_CHUNK_BYTES``, whatever lengths are claimed.

Source: https://mcap.dev/spec
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple, TypeAlias

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message, Metadata, Schema

from ltv_mpc.errors import ConfigError

MAGIC = b"\x89MCAP0\r\n"
MAX_CHUNK_BYTES = 1 << 24
"""Bytes; our own chunks have 1 MiB and a message more."""

_HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
MESSAGE = int(Opcode.MESSAGE)  # a comparison of plain numbers, some hundred thousand times a file

RUBBISH = (McapError, ValueError, OverflowError, struct.error, zstandard.ZstdError, MemoryError)
"""What mcap, zstd and struct raise on damaged content; UnicodeDecodeError is a ValueError."""

Record: TypeAlias = Schema | Channel | Message | Metadata

_watcher: ContextVar[Callable[[float], None] | None] = ContextVar("watcher of readings", default=None)


@contextmanager
def report_progress(told: Callable[[float], None]) -> Iterator[None]:
    """Who reads within it, however deep, tells which share of a file it has read."""
    before = _watcher.set(told)
    try:
        yield
    finally:
        _watcher.reset(before)


def start_of(metadata: dict[str, str]) -> int:
    """Vehicle time (ns) that log time 0 stands for; 0 where the file does not say."""
    text = metadata.get("start_ns", "0")
    return int(text) if re.fullmatch(r"-?\d{1,19}", text) else 0


class Loss(NamedTuple):
    """Bytes of the file that gave nothing."""

    offset: int
    length: int
    why: str


class Records:
    """The file's schemas, channels, messages and metadata, in its order; a message never comes before its channel.

    Once iterated: ``whole`` says whether the file has its end and lost nothing, ``losses`` which bytes gave nothing,
    ``orphans`` how many messages were left out because the record that names their channel is lost. ``position`` is
    how far it was read, of ``size`` bytes. Iterating raises ``ConfigError`` where the file is no MCAP file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.size = 0
        self.position = 0
        self.losses: list[Loss] = []
        self.orphans = 0
        self.finished = False
        self._channels: set[int] = set()

    @property
    def whole(self) -> bool:
        """Whether nothing is missing."""
        return self.finished and not self.losses and not self.orphans

    @property
    def lost_bytes(self) -> int:
        """All bytes that gave nothing."""
        return sum(loss.length for loss in self.losses)

    def __iter__(self) -> Iterator[Record]:
        self.losses, self.orphans, self.finished = [], 0, False
        self._channels.clear()
        with self.path.open("rb") as file:
            self.size = file.seek(0, 2)
            file.seek(0)
            if file.read(len(MAGIC)) != MAGIC[: self.size]:
                raise ConfigError(f"recording {self.path}", "", "not an MCAP file")
            yield from self._records(file)  # nothing of a file whose writer was killed before its first record

    def _records(self, file: BinaryIO) -> Iterator[Record]:
        summary = False  # what follows DataEnd repeats what was there
        told = _watcher.get()
        while True:
            start = self.position = file.tell()
            if told is not None:
                told(start / self.size)
            head = file.read(_HEAD.size)
            if len(head) < _HEAD.size:
                if head:
                    self._lose(start, len(head), "cut in the head of a record")
                return
            opcode, length = _HEAD.unpack(head)
            if file.tell() + length > self.size:
                self._lose(start, self.size - start, f"cut in a record of {length} bytes")
                return
            content = file.read(length)
            if opcode == Opcode.FOOTER:
                self._end(file)
                return
            if opcode == Opcode.DATA_END:
                summary = True
            elif not summary:
                try:
                    found = list(_opened(opcode, content))
                except RUBBISH as error:
                    why = " ".join(str(error).split()) or type(error).__name__
                    self._lose(start, _HEAD.size + length, f"{_name(opcode)}: {why}"[:200])
                else:
                    yield from filter(self._is_known, found)

    def _end(self, file: BinaryIO) -> None:
        rest = file.read()
        self.finished = rest.startswith(MAGIC)
        if rest != MAGIC:
            self._lose(self.size - len(rest), len(rest), "the end of the MCAP file is missing")

    def _lose(self, offset: int, length: int, why: str) -> None:
        self.losses.append(Loss(offset, length, why))

    def _is_known(self, record: Record) -> bool:
        """Whether it is no message of a channel that was lost."""
        if isinstance(record, Channel):
            self._channels.add(record.id)
        elif isinstance(record, Message) and record.channel_id not in self._channels:
            self.orphans += 1
            return False
        return True


def _opened(opcode: int, content: bytes) -> Iterator[Record]:
    """What a record holds."""
    match opcode:
        case Opcode.CHUNK:
            yield from _chunk(Chunk.read(_stream(content)))
        case Opcode.MESSAGE:
            yield _message(content, 0, len(content))
        case Opcode.CHANNEL:
            yield Channel.read(_stream(content))
        case Opcode.SCHEMA:
            yield Schema.read(_stream(content))
        case Opcode.METADATA:
            yield Metadata.read(_stream(content))
        case _:  # an index, or a record of a later version
            pass


def _chunk(chunk: Chunk) -> Iterator[Record]:
    data = _decompressed(chunk)
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError("its checksum is wrong")
    start = 0
    while start < len(data):
        opcode, length = _HEAD.unpack_from(data, start)
        start += _HEAD.size + length
        if start > len(data) or opcode == Opcode.CHUNK:
            raise ValueError("a record type that a chunk cannot hold")
        if opcode == MESSAGE:
            yield _message(data, start - length, start)
        else:
            yield from _opened(opcode, data[start - length : start])


def _message(data: bytes, start: int, end: int) -> Message:
    channel, sequence, log_time, publish_time = _MESSAGE.unpack_from(data, start)
    return Message(channel, log_time, data[start + _MESSAGE.size : end], publish_time, sequence)


def _decompressed(chunk: Chunk) -> bytes:
    if chunk.uncompressed_size > MAX_CHUNK_BYTES:
        raise ValueError(f"{chunk.uncompressed_size} bytes, at most {MAX_CHUNK_BYTES}")
    if chunk.compression == "zstd":
        # The frame says a size of its own, which zstd would believe.
        if zstandard.frame_content_size(chunk.data) > MAX_CHUNK_BYTES:
            raise ValueError("its zstd frame claims too many bytes")
        return zstandard.decompress(chunk.data, chunk.uncompressed_size)
    if chunk.compression:
        raise ValueError(f"compressed by {chunk.compression[:20]!r}, which is not supported")
    return chunk.data


def _stream(content: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(content))


def _name(opcode: int) -> str:
    try:
        return Opcode(opcode).name.lower().replace("_", " ")
    except ValueError:
        return f"record {opcode}"
