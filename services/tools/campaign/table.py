"""Parquet tables of a campaign.

results.parquet       all rows, ordered by point and seed, without host and times: the same bytes from any executor
timing.parquet        host, end time and duration of each run
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from services.run.folder import draft_of
from services.tools.campaign.file import Campaign, metrics
from services.tools.campaign.trial import COUNTS, TIMING, Row

RESULTS, TIMES = "results.parquet", "timing.parquet"


def write(folder: Path, campaign: Campaign, rows: Iterable[Row], metadata: Mapping[str, str]) -> None:
    """Write results.parquet and timing.parquet into ``folder``; ``metadata`` goes into the results.

    The columns: point and seed, varied keys, version, failure, result values, counts, host and times.
    """
    ordered = sorted(rows, key=lambda row: (row["point"], row["seed"]))
    keys = "point", "seed", *campaign.varied, "version", "failed", *metrics(), *COUNTS, *TIMING
    whole = pa.table({key: _column(key, [row.get(key) for row in ordered]) for key in keys})
    _write(whole.drop_columns(list(TIMING)).replace_schema_metadata(dict(metadata)), folder / RESULTS)
    _write(whole.select(["point", "seed", *TIMING]), folder / TIMES)


def _column(key: str, values: Sequence[object]) -> pa.Array:
    """Return a column of the type of its values; without any it is one of numbers, or of text for the failure."""
    column = pa.array(values)
    return column.cast(pa.string() if key == "failed" else pa.float64()) if pa.types.is_null(column.type) else column


def _write(table: pa.Table, path: Path) -> None:
    with draft_of(path) as draft:
        pq.write_table(table, draft, compression="zstd")
