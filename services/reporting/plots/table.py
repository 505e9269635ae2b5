"""Table of bounded size for a data series of any length.

A table keeps every ``stride``-th row. When it holds twice its ``limit``, it drops every second row and doubles the
stride. With ``peak``, it keeps of each ``stride`` rows the one with the largest value in that column, so that spikes
remain visible.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any, TypeAlias

from ltv_mpc.messages import Array

Cell: TypeAlias = float | None
Columns: TypeAlias = dict[str, list[Cell]]

DECIMALS = 4
"""Decimals of metres, seconds, newtons and milliseconds: finer than the pixels of a screen."""


class Table:
    """Table of the named ``columns``. ``generation`` increases each time rows are dropped."""

    def __init__(self, columns: Sequence[str], *, limit: int, peak: str = "") -> None:
        self.columns = tuple(columns)
        self.generation = 0
        self._limit = limit
        self._peak = self.columns.index(peak) if peak else None
        self._stride = 1
        self._bucket: list[Sequence[Cell]] = []
        self._rows: list[Sequence[Cell]] = []

    def add(self, *row: Cell) -> None:
        """Add a row with a cell for each column."""
        self._bucket.append(row)
        if len(self._bucket) < self._stride:
            return
        self._rows.append(self._representative(self._bucket))
        self._bucket.clear()
        if len(self._rows) >= 2 * self._limit:
            pairs = zip(self._rows[::2], self._rows[1::2], strict=True)
            self._rows = [self._representative(pair) for pair in pairs]
            self._stride *= 2
            self.generation += 1

    def __len__(self) -> int:
        return len(self._rows)

    def since(self, row: int) -> Columns:
        """Return the columns by name, from row ``row`` to the end."""
        rows = self._rows[row:]
        return {name: [short(cells[i]) for cells in rows] for i, name in enumerate(self.columns)}

    def _representative(self, rows: Sequence[Sequence[Cell]]) -> Sequence[Cell]:
        peak = self._peak
        return rows[0] if peak is None else max(rows, key=lambda row: row[peak] or 0.0)


def short(value: Any) -> Cell:
    """Round a value to ``DECIMALS``; None if it is not finite."""
    return round(float(value), DECIMALS) if value is not None and math.isfinite(value) else None


def shorts(values: Iterable[Any]) -> list[Cell]:
    """Round values to ``DECIMALS``."""
    return [short(value) for value in values]


def points(*lines: Array) -> Columns:
    """Return lines (K, 2), north and east (m), in one table; None separates two lines."""
    columns: Columns = {"north_m": [], "east_m": []}
    for line in lines:
        for cells, values in zip(columns.values(), line.T, strict=True):
            cells += [*([None] if cells else []), *shorts(values)]
    return columns
