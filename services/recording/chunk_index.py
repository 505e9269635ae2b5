"""MCAP's index of a recording's chunks, on disk until the file ends.

The index is written last, and the package's writer keeps each entry as an object until then: 2.3 kB of memory a chunk,
29 MB in an hour of `make sim`, without end. Here an entry is the bytes that it will be in the file, in a file of its
own that has no name and is gone with the process.

The writer's list of entries is a private attribute of its own. Where a version of the package has it no more, nothing
is replaced, and the writer keeps what it keeps; a test says so.
"""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mcap.data_stream import RecordBuilder
from mcap.records import ChunkIndex
from mcap.writer import Writer

IN_MEMORY_BYTES = 256 * 1024
"""Some four hundred entries: a short run has no second file."""

BLOCK_BYTES = 64 * 1024

_ENTRIES = "_Writer__chunk_indices"


class _Block:
    """Records as they will be in the file."""

    def __init__(self, records: bytes) -> None:
        self._records = records

    def write(self, builder: RecordBuilder) -> None:
        """As any record of the package."""
        builder.write(self._records)


class Entries:
    """In place of the writer's list: it is appended to, and gone through once."""

    def __init__(self, folder: Path) -> None:
        self._file = tempfile.SpooledTemporaryFile(max_size=IN_MEMORY_BYTES, dir=str(folder))  # noqa: SIM115  (``close``)
        self._builder: Any = RecordBuilder()  # the package leaves some types out

    def append(self, entry: ChunkIndex) -> None:
        """Raises ``OSError`` where the disk does not take it."""
        entry.write(self._builder)
        self._file.write(self._builder.end())

    def __iter__(self) -> Iterator[_Block]:
        self._file.seek(0)
        while block := self._file.read(BLOCK_BYTES):
            yield _Block(block)

    def close(self) -> None:
        """It is gone."""
        self._file.close()


@contextlib.contextmanager
def on_disk(writer: Writer, folder: Path) -> Iterator[None]:
    """Within, ``writer`` keeps its index in a file in ``folder``, if it can be told to; to be entered before its first
    chunk.
    """
    entries: Any = getattr(writer, _ENTRIES, None)
    if entries != []:
        yield
        return
    with contextlib.closing(Entries(folder)) as kept:
        setattr(writer, _ENTRIES, kept)
        yield
