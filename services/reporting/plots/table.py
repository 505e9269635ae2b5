"""Columns of numbers that grow without end and never get large.

A table keeps every ``stride``-th row. When it holds twice its ``limit``, every other row goes and the stride doubles.
With ``peak`` it is not every n-th row that stays but, of each n, the one that is largest in that column: spikes stay.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, TypeAlias

Cell: TypeAlias = float | None
Columns: TypeAlias = dict[str, list[Cell]]

DECIMALS = 4
"""Of metres, seconds, newtons and milliseconds: more than a screen has pixels."""


class Table:
    """``columns`` are the rows' names. ``generation`` grows when rows that were there before have gone."""

    def __init__(self, columns: Sequence[str], *, limit: int, peak: str = "") -> None:
        self.columns = tuple(columns)
        self.generation = 0
        self._limit = limit
        self._peak = self.columns.index(peak) if peak else None
        self._stride = 1
        self._bucket: list[Sequence[Cell]] = []
        self._rows: list[Sequence[Cell]] = []

    def add(self, *row: Cell) -> None:
        """One row, a cell for each column."""
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
        """By name, from this row on."""
        rows = self._rows[row:]
        return {name: [short(cells[i]) for cells in rows] for i, name in enumerate(self.columns)}

    def _representative(self, rows: Sequence[Sequence[Cell]]) -> Sequence[Cell]:
        peak = self._peak
        return rows[0] if peak is None else max(rows, key=lambda row: row[peak] or 0.0)


def short(value: Any) -> Cell:
    """With few digits; None where it is no finite number."""
    return round(float(value), DECIMALS) if value is not None and math.isfinite(value) else None
