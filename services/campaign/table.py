"""A campaign's results on disk.

parts/part-000012.parquet   the rows of one task, written beside and renamed as they arrive; named by the first of them
results.parquet             all rows by point and seed, without anything measured: the same bytes from any engine
timing.parquet              when, where and how long each run was
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from msgspec import inspect

from services.campaign.file import Campaign, Range, figures
from services.campaign.keys import kind_of
from services.campaign.trial import COUNTS, TIMING, Row

RESULTS, TIMES, PARTS = "results.parquet", "timing.parquet", "parts"


def schema(campaign: Campaign) -> pa.Schema:
    """Columns of a part: who, the varied keys, the figures, what was measured."""
    who = [("place", pa.int64()), ("point", pa.int64()), ("seed", pa.int64())]
    varied = [(key, _column(key, over)) for key, over in campaign.varied.items()]
    what = [("version", pa.string()), ("failed", pa.string())]
    values = [
        (key, pa.int64() if isinstance(kind, inspect.IntType) else pa.float64()) for key, kind in figures().items()
    ]
    counts = [(f"{table}.{name}", pa.int64()) for table, names in COUNTS.items() for name in names]
    measured = [("host", pa.string()), ("ended", pa.string()), ("wall_s", pa.float64())]
    return pa.schema([*who, *varied, *what, *values, *counts, *measured])


def _column(key: str, over: object) -> pa.DataType:
    """By the field itself; a range is of numbers."""
    kind = kind_of(key)
    values = () if isinstance(over, Range) or not isinstance(over, tuple) else over
    if any(isinstance(value, str) for value in values):
        return pa.string()
    if values and all(isinstance(value, bool) for value in values):
        return pa.bool_()
    return pa.int64() if isinstance(kind, inspect.IntType) else pa.float64()


class Parts:
    """The folder of parts."""

    def __init__(self, folder: Path, campaign: Campaign) -> None:
        self._folder = folder
        self._schema = schema(campaign)
        folder.mkdir(exist_ok=True)
        for draft in folder.glob("*.draft"):  # of a campaign that was interrupted while it wrote
            draft.unlink()

    def write(self, rows: Sequence[Row]) -> None:
        """One part, whole or not at all."""
        path = self._folder / f"part-{rows[0]['place']:08d}.parquet"
        draft = path.with_suffix(".draft")
        pq.write_table(pa.Table.from_pylist(list(rows), schema=self._schema), draft)
        draft.replace(path)

    def done(self) -> set[int]:
        """Places of the trials that have a row."""
        return {place for path in self._paths() for place in pq.read_table(path, columns=["place"])[0].to_pylist()}

    def rows(self, columns: Sequence[str]) -> Iterable[Row]:
        """All rows so far."""
        for path in self._paths():
            yield from pq.read_table(path, columns=list(columns)).to_pylist()

    def assemble(self, folder: Path, metadata: Mapping[str, str]) -> None:
        """results.parquet and timing.parquet in ``folder``. ``metadata`` goes into the results."""
        tables = [pq.read_table(path, schema=self._schema) for path in self._paths()]
        whole = pa.concat_tables(tables or [self._schema.empty_table()])
        whole = whole.take(pc.sort_indices(whole, [("point", "ascending"), ("seed", "ascending")])).combine_chunks()
        results = whole.drop_columns(["place", *TIMING]).replace_schema_metadata(dict(metadata))
        _write(results, folder / RESULTS)
        _write(whole.select(["point", "seed", *TIMING]), folder / TIMES)

    def _paths(self) -> list[Path]:
        return sorted(self._folder.glob("part-*.parquet"))


def _write(table: pa.Table, path: Path) -> None:
    draft = path.with_suffix(".draft")
    pq.write_table(table, draft, compression="zstd")
    draft.replace(path)
