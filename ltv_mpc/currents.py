"""Current profiles as CSV: columns depth_m, v_north_mps, u_east_mps in any order, further columns ignored.

An estimated profile has two columns more, one number for north and east alike, the larger of the two:
    sd_mps         standard deviation of the whole error at that depth
    sd_common_mps  of the part of it that all depths share, the same number in every row: 0 where none is shared
With both it can be a prior: depths at which a vehicle has measured from one surface fix err together (sd_common), and
each a little by itself, sqrt(sd^2 - sd_common^2).

Lines that begin with # are comments, but a comment that holds the three names, while no header has been seen, is the
header: two published profiles carry theirs so. Above the first depth and below the last the profile is held constant.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ltv_mpc import config
from ltv_mpc.errors import ConfigError
from ltv_mpc.messages import Array, CurrentProfile

COLUMNS = ("depth_m", "v_north_mps", "u_east_mps")
SD, SD_COMMON = "sd_mps", "sd_common_mps"
MAX_CURRENT_MPS = 5.0
"""No ocean current is faster: larger numbers are in other units."""
MAX_SD_MPS = 10.0
"""Twice the fastest: whoever knows nothing of a current knows that much."""
MAX_DEPTH_M = 11_000.0

_WORD = re.compile(r"[\w.]+")


@dataclass(frozen=True, slots=True, kw_only=True)
class WaterPrior:
    """What is known of the current before a dive, NED. Depths strictly increasing; arrays (K,).

    ``sd_mps`` is of the whole error of north and of east at each depth, ``sd_common_mps`` of the part of it that all
    depths share: at most the smallest of ``sd_mps``.
    """

    depth_m: Array
    north_mps: Array
    east_mps: Array
    sd_mps: Array
    sd_common_mps: float


def read_profile(path: str | Path) -> CurrentProfile:
    """The file's profile, depths strictly increasing. Raises ``ConfigError`` with file, line, field, value, bound."""
    columns = _read(Path(path), of_prior=False)
    depth, north, east = (columns[name] for name in COLUMNS)
    return CurrentProfile(depth_m=depth, north_mps=north, east_mps=east, sd_mps=columns.get(SD))


def read_prior(path: str | Path) -> WaterPrior:
    """The file as a prior: ``read_profile``, with both columns of standard deviations there. Raises ``ConfigError``."""
    columns = _read(Path(path), of_prior=True)
    depth, north, east = (columns[name] for name in COLUMNS)
    common = float(columns[SD_COMMON][0])
    return WaterPrior(depth_m=depth, north_mps=north, east_mps=east, sd_mps=columns[SD], sd_common_mps=common)


def write_profile(path: str | Path, profile: CurrentProfile | WaterPrior) -> None:
    """``profile`` as a CSV that ``read_profile``, or of a prior ``read_prior``, reads back bit for bit."""
    columns = dict(zip(COLUMNS, (profile.depth_m, profile.north_mps, profile.east_mps), strict=True))
    if profile.sd_mps is not None:
        columns[SD] = profile.sd_mps
    if isinstance(profile, WaterPrior):
        columns[SD_COMMON] = np.full_like(profile.depth_m, profile.sd_common_mps)
    rows = zip(*(column.tolist() for column in columns.values()), strict=True)
    lines = [",".join(columns), *(",".join(map(repr, row)) for row in rows)]
    Path(path).write_text("\n".join(lines) + "\n", encoding="utf-8")


def _read(path: Path, *, of_prior: bool) -> dict[str, Array]:
    """The columns that are there, by name, each (K,)."""
    source = f"currents {path}"
    lines = config.read_text(path, what="currents").splitlines()
    header, first = _header(lines, source, of_prior=of_prior)
    rows: list[dict[str, float]] = []
    for number, line in enumerate(lines[first:], start=first + 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        row = _row(line, number, header, source)
        _related(row, rows, number, source)
        rows.append(row)
    if not rows:
        raise ConfigError(source, "", "no row of numbers below the header; one depth is the least")
    return {name: np.array([row[name] for row in rows]) for name in header}


def _related(row: Mapping[str, float], before: Sequence[Mapping[str, float]], number: int, source: str) -> None:
    """What no number of a row can tell alone."""
    if before and row["depth_m"] <= before[-1]["depth_m"]:
        problem = f"must be below the depth before it, {before[-1]['depth_m']:g} m"
        raise ConfigError(source, f"line {number} depth_m", problem, value=row["depth_m"])
    if SD_COMMON not in row:
        return
    common = row[SD_COMMON]
    if before and common != before[0][SD_COMMON]:
        problem = f"must be the same in every row, as above {before[0][SD_COMMON]:g} m/s"
        raise ConfigError(source, f"line {number} {SD_COMMON}", problem, value=common)
    if common > row[SD]:
        problem = f"must be <= {SD} = {row[SD]:g}, of which it is a part"
        raise ConfigError(source, f"line {number} {SD_COMMON}", problem, value=common)


def _header(lines: Sequence[str], source: str, *, of_prior: bool) -> tuple[dict[str, int], int]:
    """Positions of the columns by name, and how many lines precede the first that may hold numbers."""
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
                return _positions(names, number, source, of_prior=of_prior), number
            break
    if in_comment is None:
        raise ConfigError(source, "", f"missing header; it must name {', '.join(COLUMNS)}")
    names, number = in_comment
    return _positions(names, number, source, of_prior=of_prior), number


def _positions(names: Sequence[str], number: int, source: str, *, of_prior: bool) -> dict[str, int]:
    """``sd_mps`` is read where it is there, ``sd_common_mps`` for a prior alone: elsewhere it is one more column."""
    for name in COLUMNS:
        if name not in names:
            raise ConfigError(
                source, f"line {number}", f"missing column {name}; the header must name {', '.join(COLUMNS)}"
            )
    if of_prior:
        for name, meaning in (
            (SD, "standard deviation at each depth"),
            (SD_COMMON, "standard deviation of what all depths share, one number in every row; 0 for nothing"),
        ):
            if name not in names:
                raise ConfigError(source, f"line {number}", f"missing column {name}: a prior needs it ({meaning})")
    wanted = (*COLUMNS, *((SD,) if SD in names else ()), *((SD_COMMON,) if of_prior else ()))
    for name in wanted:
        if names.count(name) > 1:
            raise ConfigError(source, f"line {number}", f"column {name} stands there twice")
    return {name: names.index(name) for name in wanted}


_BOUNDS = {
    "depth_m": (0.0, MAX_DEPTH_M, f"must be >= 0 and <= {MAX_DEPTH_M:g} m, positive down"),
    "v_north_mps": (-MAX_CURRENT_MPS, MAX_CURRENT_MPS, f"must be within +-{MAX_CURRENT_MPS:g} m/s"),
    "u_east_mps": (-MAX_CURRENT_MPS, MAX_CURRENT_MPS, f"must be within +-{MAX_CURRENT_MPS:g} m/s"),
    SD: (0.0, MAX_SD_MPS, f"must be >= 0 and <= {MAX_SD_MPS:g} m/s, a standard deviation"),
    SD_COMMON: (0.0, MAX_SD_MPS, f"must be >= 0 and <= {MAX_SD_MPS:g} m/s, a standard deviation"),
}


def _row(line: str, number: int, header: Mapping[str, int], source: str) -> dict[str, float]:
    cells = _cells(line)
    values: dict[str, float] = {}
    for name, position in header.items():
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
        low, high, words = _BOUNDS[name]
        if not low <= value <= high:
            raise ConfigError(source, field, words, value=value)
        values[name] = value
    return values


def _cells(line: str) -> list[str]:
    return next(csv.reader([line]), [])
