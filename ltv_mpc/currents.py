"""Current profiles as CSV: columns depth_m, v_north_mps, u_east_mps in any order, further columns ignored.

Lines that begin with # are comments, but a comment that holds the three names, while no header has been seen, is the
header: two published profiles carry theirs so. Above the first depth and below the last the profile is held constant.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ltv_mpc import config
from ltv_mpc.errors import ConfigError
from ltv_mpc.signals import CurrentProfile

COLUMNS = ("depth_m", "v_north_mps", "u_east_mps")
FASTEST_MPS = 5.0
"""No ocean current is faster: larger numbers are in other units."""
DEEPEST_M = 11_000.0

_WORD = re.compile(r"[\w.]+")


def read_profile(path: str | Path) -> CurrentProfile:
    """The file's profile, depths strictly increasing. Raises ``ConfigError`` with file, line, field, value, bound."""
    path = Path(path)
    source = f"currents {path}"
    lines = config.read_text(path, what="currents").splitlines()
    header, first = _header(lines, source)
    rows: list[tuple[float, float, float]] = []
    for number, line in enumerate(lines[first:], start=first + 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        row = _row(line, number, header, source)
        if rows and row[0] <= rows[-1][0]:
            raise ConfigError(
                source, f"line {number} depth_m", f"must be below the depth before it, {rows[-1][0]:g} m", value=row[0]
            )
        rows.append(row)
    if not rows:
        raise ConfigError(source, "", "no row of numbers below the header; one depth is the least")
    depth, north, east = np.array(rows, dtype=np.float64).T.copy()
    return CurrentProfile(depth_m=depth, north_mps=north, east_mps=east)


def write_profile(path: str | Path, profile: CurrentProfile) -> None:
    """``profile`` as a CSV that ``read_profile`` reads back bit for bit."""
    rows = zip(profile.depth_m.tolist(), profile.north_mps.tolist(), profile.east_mps.tolist(), strict=True)
    lines = [",".join(COLUMNS), *(",".join(map(repr, row)) for row in rows)]
    Path(path).write_text("\n".join(lines) + "\n", encoding="utf-8")


def _header(lines: Sequence[str], source: str) -> tuple[tuple[int, int, int], int]:
    """Positions of the three columns, and how many lines precede the first that may hold numbers."""
    in_comment: tuple[list[str], int] | None = None
    for number, line in enumerate(lines, start=1):
        if line.lstrip().startswith("#"):
            # Prose may follow a name, so each cell of a comment counts by its first word.
            words = [_WORD.match(cell.strip(" \t#\"'")) for cell in line.split(",")]
            names = [word.group() if word else "" for word in words]
            if in_comment is None and all(name in names for name in COLUMNS):
                in_comment = names, number
        elif line.strip():
            names = [cell.strip() for cell in _cells(line)]
            if in_comment is None or all(name in names for name in COLUMNS):
                return _positions(names, number, source), number
            break
    if in_comment is None:
        raise ConfigError(source, "", f"missing header; it must name {', '.join(COLUMNS)}")
    names, number = in_comment
    return _positions(names, number, source), number


def _positions(names: Sequence[str], number: int, source: str) -> tuple[int, int, int]:
    for name in COLUMNS:
        if name not in names:
            raise ConfigError(
                source, f"line {number}", f"missing column {name}; the header must name {', '.join(COLUMNS)}"
            )
        if names.count(name) > 1:
            raise ConfigError(source, f"line {number}", f"column {name} stands there twice")
    return names.index(COLUMNS[0]), names.index(COLUMNS[1]), names.index(COLUMNS[2])


def _row(line: str, number: int, header: tuple[int, int, int], source: str) -> tuple[float, float, float]:
    cells = _cells(line)
    values = []
    for name, position in zip(COLUMNS, header, strict=True):
        field = f"line {number} {name}"
        if position >= len(cells):
            raise ConfigError(source, field, f"missing: column {position + 1} of a line that has {len(cells)}")
        cell = cells[position].strip()
        try:
            value: float | None = float(cell)
        except ValueError:
            value = None
        if value is None or "_" in cell:  # Python reads 1_0 as ten
            raise ConfigError(source, field, "must be a number", value=cell[:40]) from None
        if not math.isfinite(value):
            raise ConfigError(source, field, "must be finite", value=cell)
        if name == "depth_m" and not 0.0 <= value <= DEEPEST_M:
            raise ConfigError(source, field, f"must be >= 0 and <= {DEEPEST_M:g} m, positive down", value=value)
        if name != "depth_m" and not abs(value) <= FASTEST_MPS:
            raise ConfigError(source, field, f"must be within +-{FASTEST_MPS:g} m/s", value=value)
        values.append(value)
    return values[0], values[1], values[2]


def _cells(line: str) -> list[str]:
    return next(csv.reader([line]), [])
