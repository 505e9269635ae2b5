"""Parquet tables of a campaign.

results.parquet       all rows, ordered by point and seed, without host and times: the same bytes from any executor
timing.parquet        host, end time and duration of each run
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
from msgspec import inspect

from services.tools.campaign.file import KINDS, Campaign, Range, metrics
from services.tools.campaign.trial import COUNTS, TIMING, Row

RESULTS, TIMES = "results.parquet", "timing.parquet"


def schema(campaign: Campaign) -> pa.Schema:
    """Return the columns: point and seed, varied keys, version, failure, result values, counts, host and times."""
    who = [("point", pa.int64()), ("seed", pa.int64())]
    varied = [(key, _column(key, over)) for key, over in campaign.varied.items()]
    what = [("version", pa.string()), ("failed", pa.string())]
    values = [
        (key, pa.int64() if isinstance(kind, inspect.IntType) else pa.float64()) for key, kind in metrics().items()
    ]
    counts = [(key, pa.int64()) for key in COUNTS]
    measured = [("host", pa.string()), ("ended", pa.string()), ("wall_s", pa.float64())]
    return pa.schema([*who, *varied, *what, *values, *counts, *measured])


def _column(key: str, over: object) -> pa.DataType:
    """Return the column type of a varied key, from the field's type and its values."""
    kind = KINDS.get(key)
    values = () if isinstance(over, Range) or not isinstance(over, tuple) else over
    if any(isinstance(value, str) for value in values):
        return pa.string()
    if values and all(isinstance(value, bool) for value in values):
        return pa.bool_()
    return pa.int64() if isinstance(kind, inspect.IntType) else pa.float64()


def write(folder: Path, campaign: Campaign, rows: Iterable[Row], metadata: Mapping[str, str]) -> None:
    """Write results.parquet and timing.parquet into ``folder``; ``metadata`` goes into the results."""
    ordered = sorted(rows, key=lambda row: (row["point"], row["seed"]))
    whole = pa.Table.from_pylist(ordered, schema=schema(campaign))
    _write(whole.drop_columns(list(TIMING)).replace_schema_metadata(dict(metadata)), folder / RESULTS)
    _write(whole.select(["point", "seed", *TIMING]), folder / TIMES)


def _write(table: pa.Table, path: Path) -> None:
    draft = path.with_suffix(".draft")
    pq.write_table(table, draft, compression="zstd")
    draft.replace(path)
