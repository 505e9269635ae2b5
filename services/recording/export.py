"""Export of a recording as tables: one CSV or Parquet file for each key, one row for each message or inertial sample.

    published_s, published_ns   vehicle time of publication
    t_s, t_ns                   validity time, if the message has one
    ...                         the header's fields, then the message's own, by their names on the bus, with units

A nested field is ``outer.inner``. A list of numbers has a column for each entry, ``name_0``, ``name_1``; a matrix
``name_0_0``, ``name_0_1``. Any other list is JSON text. A missing value is an empty cell (null).
"""

from __future__ import annotations

import csv
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal, TypeAlias

import msgspec

from ltv_mpc.errors import ConfigError
from ltv_mpc.messages import ImuSamples
from services.bus import topics
from services.recording.reader import Recording, StoredMessage

Format: TypeAlias = Literal["csv", "parquet"]
Row: TypeAlias = dict[str, Any]
"""Cells by column: numbers, booleans, texts, None."""
Kinds: TypeAlias = dict[str, set[type]]
"""Types that were seen in the cells of each column."""

MAX_ENTRIES = 1024
"""Entries of a list that have columns; a longer one is JSON text."""
MAX_KEYS = 500
BATCH_ROWS = 5000
"""Rows of a file that are kept in memory, and of the row groups of a Parquet file."""
INT64 = 2**63
NOTHING = type(None)
NUMBERS = {int, float, NOTHING}


class ExportedFile(msgspec.Struct, frozen=True, kw_only=True):
    """File that was written."""

    file: str
    key: str
    rows: int
    columns: int


class ExportResult(msgspec.Struct, frozen=True, kw_only=True):
    """Result of an export. ``unreadable`` counts the messages that are not a JSON object and were skipped."""

    folder: str
    files: tuple[ExportedFile, ...]
    unreadable: int


def export(parts: Sequence[Path], folder: Path, form: Format) -> ExportResult:
    """Export the recording's segments as tables into ``folder``, which exists. It reads them twice: first the columns.

    Raises ``ConfigError`` if a segment is not an MCAP file, or pyarrow is needed and not installed.
    """
    if form == "parquet":
        need_pyarrow()
    kinds: dict[str, Kinds] = {}
    unreadable = 0
    for key, row in _rows(parts):
        if row is None:
            unreadable += 1
            continue
        if key not in kinds and len(kinds) >= MAX_KEYS:
            raise ConfigError(f"recording {parts[0]}", "", f"more than {MAX_KEYS} keys")
        seen = kinds.setdefault(key, defaultdict(set))
        for column, cell in row.items():
            seen[column].add(type(cell))
    if not kinds and not unreadable:
        raise ConfigError(f"recording {parts[0]}", "", "holds no message")
    tables = {key: _Table(folder / name, key, _columns(kinds[key])) for key, name in _named(kinds, form)}
    try:
        for key, row in _rows(parts):
            if row is not None:
                tables[key].add(row)
    finally:
        for table in tables.values():
            table.close()
    files = tuple(table.exported for table in tables.values())
    return ExportResult(folder=str(folder), files=files, unreadable=unreadable)


def _rows(parts: Sequence[Path]) -> Iterator[tuple[str, Row | None]]:
    """Yield the key of each message with its row, with one of each inertial sample; None if it is not a map."""
    for stored in Recording(*parts):
        try:
            rows = list(_rows_of(stored))
        except (ValueError, TypeError, AttributeError, RecursionError):  # no map, or one that no recorder wrote
            yield stored.key, None
            continue
        for row in rows:
            yield stored.key, row


_decode = msgspec.json.Decoder().decode


def _rows_of(stored: StoredMessage) -> Iterator[Row]:
    plain = _decode(stored.data)
    for sample in plain.pop("samples", [{}]) if stored.kind is ImuSamples else [{}]:
        cells = _cells("", plain | sample)
        times = {"published_s": stored.t_ns / 1e9, "published_ns": stored.t_ns if stored.t_ns < INT64 else None}
        timed = isinstance(cells.get("t_ns"), int)
        yield times | ({"t_s": cells["t_ns"] / 1e9} if timed else {}) | cells


def _cells(name: str, value: Any) -> Row:
    """Return the cells of a value: one, or those of the fields of a map or of the numbers of a list."""
    cells: Row = {}
    if isinstance(value, dict) and (value or not name):
        for field, part in value.items():
            cells |= _cells(f"{name}.{field}" if name else field, part)
        return cells
    if isinstance(value, list) and value and not any(isinstance(part, dict) for part in value):
        for i, part in enumerate(value):
            cells |= _cells(f"{name}_{i}", part)
        if len(cells) <= MAX_ENTRIES and all(type(cell) in NUMBERS for cell in cells.values()):
            return cells
    fits = not isinstance(value, dict | list) and (not isinstance(value, int) or -INT64 <= value < INT64)
    return {name: value if fits else msgspec.json.encode(value).decode()}


def _columns(kinds: Kinds) -> dict[str, type]:
    """Return the type of each column: int, float, bool, str; or object, whose cells are JSON text.

    A field that is null in some messages and a map or a list in others has only the columns of these.
    """
    split = {column[: match.start()] for column in kinds for match in re.finditer(r"\.|_(?=[0-9_]+$)", column)}
    columns: dict[str, type] = {}
    for column, seen in kinds.items():
        found = seen - {NOTHING}
        if found == {int, float} or (not found and column not in split):
            columns[column] = float
        elif found:
            columns[column] = found.pop() if len(found) == 1 else object
    return columns


def _named(keys: Iterable[str], form: Format) -> Iterator[tuple[str, str]]:
    """Yield each key with a safe file name: keys come from a file, and must not lead out of the folder."""
    taken: set[str] = set()
    for key in sorted(keys):
        stem = name = re.sub(r"[^A-Za-z0-9_.-]", "-", key).lstrip(".-")[:100] or "key"
        count = 1
        while name.lower() in taken:
            count += 1
            name = f"{stem}-{count}"
        taken.add(name.lower())
        yield key, f"{name}.{form}"


class _Table:
    """Table of one key, written in batches of rows."""

    def __init__(self, path: Path, key: str, columns: Mapping[str, type]) -> None:
        self._columns = columns
        self._file = _CsvFile(path, columns) if path.suffix == ".csv" else _ParquetFile(path, columns, key)
        self._batch: list[Row] = []
        self._name, self._key, self._rows = path.name, key, 0

    @property
    def exported(self) -> ExportedFile:
        """Description of the file that was written."""
        return ExportedFile(file=self._name, key=self._key, rows=self._rows, columns=len(self._columns))

    def add(self, row: Row) -> None:
        """Add a row; a cell that it lacks is null."""
        self._rows += 1
        self._batch.append({column: _typed(row.get(column), kind) for column, kind in self._columns.items()})
        if len(self._batch) >= BATCH_ROWS:
            self._flush()

    def close(self) -> None:
        """Write the remaining rows and finish the file."""
        self._flush()
        self._file.close()

    def _flush(self) -> None:
        self._file.write(self._batch)
        self._batch = []


def _typed(cell: Any, kind: type) -> Any:
    if cell is None or kind in (int, bool, str):
        return cell
    return float(cell) if kind is float else msgspec.json.encode(cell).decode()


class _CsvFile:
    """File of rows as text; booleans are ``true`` and ``false``."""

    def __init__(self, path: Path, columns: Mapping[str, type]) -> None:
        self._file = path.open("w", encoding="utf-8", newline="")
        self.close = self._file.close
        self._writer = csv.DictWriter(self._file, columns, lineterminator="\n")
        self._writer.writeheader()

    def write(self, rows: Iterable[Row]) -> None:
        """Write rows."""
        words = {True: "true", False: "false"}
        for row in rows:
            self._writer.writerow({name: words[cell] if isinstance(cell, bool) else cell for name, cell in row.items()})


def need_pyarrow() -> None:
    """Check that Parquet can be written. Raises ``ConfigError`` if pyarrow is not installed."""
    if find_spec("pyarrow") is None:
        problem = "needs the package pyarrow: pip install pyarrow (extra parquet), or use --format csv"
        raise ConfigError("option --format", "", problem, value="parquet")


class _ParquetFile:
    """File of typed columns, of which each batch is a row group."""

    def __init__(self, path: Path, columns: Mapping[str, type], key: str) -> None:
        import pyarrow as pa
        from pyarrow import parquet as pq

        topic = topics.topic_at(key)
        about = {"ltv_mpc.key": key, "ltv_mpc.message": "" if topic is None else topic.message_type.__name__}
        types = {int: pa.int64(), float: pa.float64(), bool: pa.bool_(), str: pa.string(), object: pa.string()}
        self._schema = pa.schema([(name, types[kind]) for name, kind in columns.items()], metadata=about)
        self._table = pa.Table
        self._file = pq.ParquetWriter(path, self._schema, compression="zstd")
        self.close = self._file.close

    def write(self, rows: list[Row]) -> None:
        """Write a batch of rows."""
        self._file.write_table(self._table.from_pylist(rows, schema=self._schema))
