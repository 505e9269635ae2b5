"""Export of a recording as tables: one CSV or Parquet file for each key, one row for each message or inertial sample.

    published_s, published_ns   vehicle time of publication
    t_s, t_ns                   validity time, if the message has one
    ...                         the header's fields, then the message's own, by their names on the bus, with units

A nested field is ``outer.inner``. A list that has the same length in every message of its key becomes one column for
each entry, ``name_0``, ``name_1``; a matrix ``name_0_0``, ``name_0_1``. A list of varying length is one column: JSON in
CSV, a list in Parquet. Structures of varying form are JSON in both. A missing value is an empty cell (null).
"""

from __future__ import annotations

import csv
import itertools
import math
import re
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path
from types import NoneType
from typing import IO, Any, Literal, Protocol, TypeAlias

import msgspec

from ltv_mpc.errors import ConfigError
from ltv_mpc.messages import ImuSamples
from services.bus import topics
from services.recording.reader import StoredMessage, read_segments

Format: TypeAlias = Literal["csv", "parquet"]

MAX_COLUMNS = 1024
"""Columns of one field; a longer list is one column."""
MAX_KEYS = 500
BATCH_ROWS = 5000
"""Rows of a table that are kept in memory; also the row group of Parquet."""
INT64 = 2**63
MAX_FLOAT_INT = 2**1023
"""Larger integers do not fit a float and become text."""

_SCALARS: dict[type, str] = {int: "int", float: "float", bool: "bool", str: "text"}
_NUMBERS = {int, float, NoneType}


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


class Column(msgspec.Struct, frozen=True, kw_only=True):
    """Column of a table. ``kind``: int, float, bool, text, json; or numbers or integers, lists of ``depth`` levels."""

    name: str
    kind: str
    depth: int = 0


class ColumnMapping(msgspec.Struct, frozen=True, kw_only=True):
    """Mapping of a message field to columns: one, or one for each entry of a list of ``shape``."""

    path: str
    columns: tuple[Column, ...]
    shape: tuple[int, ...] = ()
    mixed: bool = False  # a list of integers and floats, which tables do not mix

    def cells(self, value: Any) -> Sequence[Any]:
        """Return the cell of each column."""
        if value is None:
            return (None,) * len(self.columns)
        if self.mixed:
            value = _floats(value)
        if len(self.shape) == 2:
            return [entry for row in value for entry in row]
        if self.shape:
            return value  # type: ignore[no-any-return]
        kind = self.columns[0].kind
        if kind == "json":
            return (msgspec.json.encode(value).decode(),)
        return (float(value) if kind == "float" else value,)


class Sink(Protocol):
    """Output file for rows."""

    def write(self, rows: Sequence[Sequence[Any]]) -> None:
        """Append rows; a row has a value for each column."""
        ...

    def close(self) -> None:
        """Finish the file."""
        ...


def export(parts: Sequence[Path], folder: Path, form: Format) -> ExportResult:
    """Export the recording's segments as tables into ``folder``, which exists.

    Raises ``ConfigError`` if a segment is not an MCAP file, or pyarrow is needed and not installed.
    """
    open_sink = _CsvSink if form == "csv" else _parquet()
    layouts: dict[str, dict[str, _Field]] = {}
    unreadable = 0
    for raw, message in _rows(parts):
        if message is None:
            unreadable += 1
            continue
        if raw.key not in layouts and len(layouts) >= MAX_KEYS:
            raise ConfigError(f"recording {parts[0]}", "", f"more than {MAX_KEYS} keys")
        fields = layouts.setdefault(raw.key, defaultdict(_Field))
        for path, value in message.items():
            fields[path].add(value)
    tables = {
        key: _Table(key, _mappings(fields), folder, name, open_sink) for key, fields, name in _named(layouts, form)
    }
    try:
        for raw, message in _rows(parts):
            if message is not None:
                tables[raw.key].add(raw.t_ns, message)
    finally:
        for table in tables.values():
            table.close()
    files = tuple(table.exported for table in tables.values())
    return ExportResult(folder=str(folder), files=files, unreadable=unreadable)


def _rows(parts: Sequence[Path]) -> Iterator[tuple[StoredMessage, dict[str, Any] | None]]:
    """Yield each message with its flattened map, each inertial sample with one of its own; None if it is not a map."""
    decode = msgspec.json.Decoder().decode
    for raw in read_segments(parts):
        try:
            plain = decode(raw.data)
            samples = plain.pop("samples", [{}]) if raw.kind is ImuSamples else [{}]
            rows = [dict(_leaves(plain | sample, "")) for sample in samples]
        except (ValueError, TypeError, AttributeError, RecursionError):  # no map, or one that no recorder wrote
            yield raw, None
            continue
        for row in rows:
            yield raw, row


def _leaves(table: dict[str, Any], prefix: str) -> Iterator[tuple[str, Any]]:
    for name, value in table.items():
        if isinstance(value, dict) and value:
            yield from _leaves(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def _named(layouts: dict[str, dict[str, _Field]], form: Format) -> Iterator[tuple[str, dict[str, _Field], str]]:
    """Yield each key with a safe file name: keys come from a file, and must not lead out of the folder."""
    taken: set[str] = set()
    for key in sorted(layouts):
        stem = name = re.sub(r"[^A-Za-z0-9_.-]", "-", key).lstrip(".-")[:100] or "key"
        count = 1
        while name.lower() in taken:
            count += 1
            name = f"{stem}-{count}"
        taken.add(name.lower())
        yield key, layouts[key], f"{name}.{form}"


class _Field:
    """Types and shapes seen in one field."""

    def __init__(self) -> None:
        self.kinds: set[str] = set()
        self._shapes: set[tuple[int, ...] | None] = set()
        self._entries: set[type] = set()

    def add(self, value: Any) -> None:
        """Add a value of a message."""
        if value is None:
            return
        if isinstance(value, list):
            self.kinds.add("list")
            self._add_list(value)
            return
        kind = _SCALARS.get(type(value), "json")
        if kind == "int" and not -INT64 <= value < INT64:
            kind = "float" if abs(value) < MAX_FLOAT_INT else "json"
        self.kinds.add(kind)

    def spread(self, path: str) -> ColumnMapping:
        """Return the columns for all values seen."""
        if self.kinds == {"list"}:
            return self._spread_list(path)
        if self.kinds <= {"int", "float"}:  # none of them: always null
            kind = "int" if self.kinds == {"int"} else "float"
        else:
            kind = next(iter(self.kinds)) if len(self.kinds) == 1 else "json"
        return ColumnMapping(path=path, columns=(Column(name=path, kind=kind),))

    def _add_list(self, value: list[Any]) -> None:
        rows = value if value and all(type(row) is list for row in value) else [value]
        entries = {type(entry) for row in rows for entry in row}
        if int in entries:
            largest = max(abs(x) for row in rows for x in row if type(x) is int)
            entries |= {float} if largest >= INT64 else set()
            entries |= {str} if largest >= MAX_FLOAT_INT else set()
        even = entries <= _NUMBERS and len({len(row) for row in rows}) == 1
        self._entries |= entries
        if len(self._shapes) < 3:  # with three different shapes it varies anyway
            shape = (len(value),) if rows[0] is value else (len(rows), len(rows[0]))
            self._shapes.add(shape if even else None)
        elif not even:
            self._shapes = {None}

    def _spread_list(self, path: str) -> ColumnMapping:
        shapes = self._shapes
        if None in shapes or len({len(shape) for shape in shapes if shape is not None}) > 1:
            return ColumnMapping(path=path, columns=(Column(name=path, kind="json"),))
        shape = next(iter(shapes)) or ()
        whole = self._entries <= {int, NoneType} and int in self._entries
        mixed = not whole and int in self._entries
        if len(shapes) > 1 or not 0 < math.prod(shape) <= MAX_COLUMNS:
            kind = "integers" if whole else "numbers"
            return ColumnMapping(path=path, columns=(Column(name=path, kind=kind, depth=len(shape)),), mixed=mixed)
        kind = "int" if whole else "float"
        places = itertools.product(*map(range, shape))
        columns = tuple(Column(name="_".join((path, *map(str, place))), kind=kind) for place in places)
        return ColumnMapping(path=path, columns=columns, shape=shape, mixed=mixed)


def _floats(value: list[Any]) -> list[Any]:
    return [_floats(x) if isinstance(x, list) else None if x is None else float(x) for x in value]


def _mappings(fields: dict[str, _Field]) -> list[ColumnMapping]:
    """Return the mappings of a key's fields in the order in which they were first seen."""
    parents = {path.rpartition(".")[0] for path in fields}
    # a field that is null in some messages and a map in others has the columns of the map
    return [field.spread(path) for path, field in fields.items() if field.kinds or path not in parents]


class _Table:
    """Table of one key, written in batches of rows."""

    def __init__(
        self,
        key: str,
        spreads: list[ColumnMapping],
        folder: Path,
        name: str,
        open_sink: Callable[[Path, str, list[Column]], Sink],
    ) -> None:
        self._key, self._name, self._spreads = key, name, spreads
        columns = [column for spread in spreads for column in spread.columns]
        self._timed = Column(name="t_ns", kind="int") in columns
        times = [Column(name="published_s", kind="float"), Column(name="published_ns", kind="int")]
        times += [Column(name="t_s", kind="float")] if self._timed else []
        self._width = len(times) + len(columns)
        self._sink = open_sink(folder / name, key, [*times, *columns])
        self._rows: list[list[Any]] = []
        self._count = 0

    @property
    def exported(self) -> ExportedFile:
        """Description of the file that was written."""
        return ExportedFile(file=self._name, key=self._key, rows=self._count, columns=self._width)

    def add(self, published_ns: int, message: dict[str, Any]) -> None:
        """Add a message of the key."""
        row: list[Any] = [published_ns / 1e9, published_ns if published_ns < INT64 else None]
        if self._timed:
            t_ns = message.get("t_ns")
            row.append(None if t_ns is None else t_ns / 1e9)
        for spread in self._spreads:
            row += spread.cells(message.get(spread.path))
        self._rows.append(row)
        self._count += 1
        if len(self._rows) >= BATCH_ROWS:
            self._flush()

    def close(self) -> None:
        """Write the remaining rows and finish the file."""
        self._flush()
        self._sink.close()

    def _flush(self) -> None:
        if self._rows:
            self._sink.write(self._rows)
            self._rows = []


class _CsvSink:
    def __init__(self, path: Path, _key: str, columns: list[Column]) -> None:
        self._file: IO[str] = path.open("w", encoding="utf-8", newline="")
        self._writer = csv.writer(self._file, lineterminator="\n")
        self._writer.writerow([column.name for column in columns])
        self._as_json = [i for i, column in enumerate(columns) if column.kind in ("numbers", "integers", "bool")]

    def write(self, rows: Sequence[Sequence[Any]]) -> None:
        for row in rows:
            cells = list(row)
            for i in self._as_json:
                if cells[i] is not None:
                    cells[i] = msgspec.json.encode(cells[i]).decode()
            self._writer.writerow(cells)

    def close(self) -> None:
        self._file.close()


def need_pyarrow() -> None:
    """Check that Parquet can be written. Raises ``ConfigError`` if pyarrow is not installed."""
    if find_spec("pyarrow") is None:
        problem = "needs the package pyarrow: pip install pyarrow (extra parquet), or use --format csv"
        raise ConfigError("option --format", "", problem, value="parquet")


def _parquet() -> Callable[[Path, str, list[Column]], Sink]:
    need_pyarrow()
    import pyarrow as pa
    from pyarrow import parquet as pq

    number, integer, text = pa.float64(), pa.int64(), pa.string()
    scalar = {"int": integer, "float": number, "bool": pa.bool_(), "text": text, "json": text}
    scalar |= {"numbers": number, "integers": integer}

    def kind(column: Column) -> Any:
        made = scalar[column.kind]
        for _ in range(column.depth):
            made = pa.list_(made)
        return made

    class ParquetSink:
        def __init__(self, path: Path, key: str, columns: list[Column]) -> None:
            topic = topics.topic_at(key)
            about = {"ltv_mpc.key": key, "ltv_mpc.message": "" if topic is None else topic.message_type.__name__}
            self._schema = pa.schema([(column.name, kind(column)) for column in columns], metadata=about)
            self._writer = pq.ParquetWriter(path, self._schema, compression="zstd")

        def write(self, rows: Sequence[Sequence[Any]]) -> None:
            arrays = [
                pa.array(values, type=field.type)
                for values, field in zip(zip(*rows, strict=True), self._schema, strict=True)
            ]
            self._writer.write_table(pa.Table.from_arrays(arrays, schema=self._schema))

        def close(self) -> None:
            self._writer.close()

    return ParquetSink
