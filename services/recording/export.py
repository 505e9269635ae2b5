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
from collections.abc import Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal, TypeAlias

import msgspec
import numpy as np

from ltv_mpc.errors import ConfigError
from ltv_mpc.messages import ImuSamples
from services.bus import topics
from services.recording.reader import Recording, StoredMessage

Format: TypeAlias = Literal["csv", "parquet"]

MAX_COLUMNS = 1024
"""Columns of one field; a longer list is one column."""
MAX_KEYS = 500
BATCH_ROWS = 5000
"""Rows of a Parquet file that are kept in memory, and of its row groups."""
INT64 = 2**63
MAX_FLOAT_INT = 2**1023
"""Larger integers do not fit a float and become text."""

_KINDS: dict[type, str] = {int: "int", float: "float", bool: "bool", str: "text"}
_NUMBERS = {"int", "float"}


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
    """Export the recording's segments as tables into ``folder``, which exists.

    Raises ``ConfigError`` if a segment is not an MCAP file, or pyarrow is needed and not installed.
    """
    if form == "parquet":
        need_pyarrow()
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
    if not layouts and not unreadable:
        raise ConfigError(f"recording {parts[0]}", "", "holds no message")
    tables = {key: _Table(key, fields, folder / name) for key, fields, name in _named(layouts, form)}
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
    for raw in Recording(*parts, past_losses=True):
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


class Column(msgspec.Struct, frozen=True, kw_only=True):
    """Column of a table: numbers (int, float), bool, text, json; or of lists of numbers, ``depth`` levels of them."""

    name: str
    kind: str
    depth: int = 0


class _Field:
    """Types and shapes seen in one field; a scalar has the shape ()."""

    def __init__(self) -> None:
        self.kinds: set[str] = set()
        self.shapes: set[tuple[int, ...]] = set()

    def add(self, value: Any) -> None:
        """Add a value of a message."""
        if value is None:
            return
        entries, shape = _entries(value)
        kinds = {_kind(entry) for entry in entries if entry is not None}
        even = not shape or (len(shape) <= 2 and kinds <= _NUMBERS)
        self.shapes.add(shape if even else ())
        self.kinds |= kinds if even else {"json"}

    def columns(self, path: str) -> tuple[Column, ...]:
        """Return the columns for all values seen: one, or one for each entry of a list."""
        depths = {len(shape) for shape in self.shapes} or {0}
        numbers = self.kinds <= _NUMBERS  # none of them: always null
        if len(depths) > 1 or not (numbers or len(self.kinds) == 1):
            return (Column(name=path, kind="json"),)
        kind = next(iter(self.kinds)) if len(self.kinds) == 1 else "float"
        shape = max(self.shapes, default=())
        if len(self.shapes) > 1 or not 0 < math.prod(shape) <= MAX_COLUMNS:
            return (Column(name=path, kind=kind, depth=len(shape)),)
        places = itertools.product(*map(range, shape))
        return tuple(Column(name="_".join((path, *map(str, place))), kind=kind) for place in places)


def _entries(value: Any) -> tuple[list[Any], tuple[int, ...]]:
    """Return the entries of a list or matrix, and its shape; rows of different lengths stay lists."""
    if not isinstance(value, list):
        return [value], ()
    array = np.array(value, dtype=object)
    return array.ravel().tolist(), array.shape


def _kind(value: Any) -> str:
    kind = _KINDS.get(type(value), "json")
    if kind == "int" and not -INT64 <= value < INT64:
        return "float" if abs(value) < MAX_FLOAT_INT else "json"
    return kind


def _cells(columns: Sequence[Column], value: Any) -> Sequence[Any]:
    """Return the cells of a field's value."""
    kind = columns[0].kind
    if value is None:
        return (None,) * len(columns)
    if kind == "json":
        return (msgspec.json.encode(value).decode(),)
    if columns[0].depth:
        return (_floats(value) if kind == "float" else value,)
    entries, _ = _entries(value)
    return _floats(entries) if kind == "float" else entries


def _floats(value: list[Any]) -> list[Any]:
    return [_floats(x) if isinstance(x, list) else None if x is None else float(x) for x in value]


class _Table:
    """Table of one key."""

    def __init__(self, key: str, fields: dict[str, _Field], path: Path) -> None:
        parents = {name.rpartition(".")[0] for name in fields}
        # A field that is null in some messages and a map in others has the columns of the map.
        self._fields = {
            name: field.columns(name) for name, field in fields.items() if field.kinds or name not in parents
        }
        self._timed = self._fields.get("t_ns") == (Column(name="t_ns", kind="int"),)
        times = [Column(name="published_s", kind="float"), Column(name="published_ns", kind="int")]
        times += [Column(name="t_s", kind="float")] if self._timed else []
        columns = [*times, *itertools.chain.from_iterable(self._fields.values())]
        self._file = _CsvFile(columns, path) if path.suffix == ".csv" else _ParquetFile(columns, path, key)
        self.close = self._file.close
        self._key, self._name, self._columns, self._rows = key, path.name, len(columns), 0

    @property
    def exported(self) -> ExportedFile:
        """Description of the file that was written."""
        return ExportedFile(file=self._name, key=self._key, rows=self._rows, columns=self._columns)

    def add(self, published_ns: int, message: dict[str, Any]) -> None:
        """Add a message of the key."""
        row: list[Any] = [published_ns / 1e9, published_ns if published_ns < INT64 else None]
        if self._timed:
            t_ns = message.get("t_ns")
            row.append(None if t_ns is None else t_ns / 1e9)
        for name, columns in self._fields.items():
            row += _cells(columns, message.get(name))
        self._file.write(row)
        self._rows += 1


class _CsvFile:
    """File of rows as text; lists and booleans are JSON."""

    def __init__(self, columns: Sequence[Column], path: Path) -> None:
        self._file = path.open("w", encoding="utf-8", newline="")
        self.close = self._file.close
        self._writer = csv.writer(self._file, lineterminator="\n")
        self._writer.writerow([column.name for column in columns])
        self._as_json = [i for i, column in enumerate(columns) if column.depth or column.kind == "bool"]

    def write(self, row: list[Any]) -> None:
        """Write a row."""
        for i in self._as_json:
            if row[i] is not None:
                row[i] = msgspec.json.encode(row[i]).decode()
        self._writer.writerow(row)


def need_pyarrow() -> None:
    """Check that Parquet can be written. Raises ``ConfigError`` if pyarrow is not installed."""
    if find_spec("pyarrow") is None:
        problem = "needs the package pyarrow: pip install pyarrow (extra parquet), or use --format csv"
        raise ConfigError("option --format", "", problem, value="parquet")


class _ParquetFile:
    """File of typed columns, written in batches of rows."""

    def __init__(self, columns: Sequence[Column], path: Path, key: str) -> None:
        import pyarrow as pa
        from pyarrow import parquet as pq

        self._pa = pa
        topic = topics.topic_at(key)
        about = {"ltv_mpc.key": key, "ltv_mpc.message": "" if topic is None else topic.message_type.__name__}
        types = {"int": pa.int64(), "float": pa.float64(), "bool": pa.bool_()}
        made = []
        for column in columns:
            kind = types.get(column.kind, pa.string())
            for _ in range(column.depth):
                kind = pa.list_(kind)
            made.append((column.name, kind))
        self._schema = pa.schema(made, metadata=about)
        self._file = pq.ParquetWriter(path, self._schema, compression="zstd")
        self._rows: list[list[Any]] = []

    def write(self, row: list[Any]) -> None:
        """Add a row."""
        self._rows.append(row)
        if len(self._rows) >= BATCH_ROWS:
            self._flush()

    def close(self) -> None:
        """Write the remaining rows and finish the file."""
        if self._rows:
            self._flush()
        self._file.close()

    def _flush(self) -> None:
        columns = zip(zip(*self._rows, strict=True), self._schema, strict=True)
        arrays = [self._pa.array(values, type=field.type) for values, field in columns]
        self._file.write_table(self._pa.Table.from_arrays(arrays, schema=self._schema))
        self._rows = []
