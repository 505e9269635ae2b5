"""Current profiles as CSV: columns depth_m, v_north_mps, u_east_mps in any order, further columns ignored.

An estimated profile has two more columns, each with one number for north and east, the larger of the two:
    sd_mps         standard deviation of the whole error at that depth (m/s)
    sd_common_mps  standard deviation of the part of the error that all depths share, the same in every row; 0 for none
With both columns a profile can be a prior: depths that a vehicle measured after one surface fix share an error
(sd_common) and have a smaller error of their own, sqrt(sd^2 - sd_common^2).

Lines that begin with # are comments. A comment before the header that holds the three names is the header: two
published profiles have it there. Above the first depth and below the last the profile is constant.
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
"""Largest current (m/s). No ocean current is faster: larger numbers are in other units."""
MAX_SD_MPS = 10.0
"""Largest standard deviation (m/s): twice the largest current, which is no knowledge at all."""
MAX_DEPTH_M = 11_000.0
"""Largest depth (m)."""

_WORD = re.compile(r"[\w.]+")


@dataclass(frozen=True, slots=True, kw_only=True)
class WaterPrior:
    """Prior knowledge of the current before a dive (m/s, NED) at K strictly increasing depths; arrays (K,).

    ``sd_mps`` is the standard deviation of the whole error of north and of east at each depth. ``sd_common_mps`` is
    that of the part that all depths share; it is at most the smallest ``sd_mps``.
    """

    depth_m: Array
    north_mps: Array
    east_mps: Array
    sd_mps: Array
    sd_common_mps: float


def read_profile(path: str | Path) -> CurrentProfile:
    """Read a current profile; its depths are strictly increasing.

    Raises
    ------
    ConfigError
        With file, line, field, value and bound.
    """
    columns = _read(Path(path), of_prior=False)
    depth, north, east = (columns[name] for name in COLUMNS)
    return CurrentProfile(depth_m=depth, north_mps=north, east_mps=east, sd_mps=columns.get(SD))


def read_prior(path: str | Path) -> WaterPrior:
    """Read a current profile as a prior; both columns of standard deviations are required.

    Raises
    ------
    ConfigError
        With file, line, field, value and bound.
    """
    columns = _read(Path(path), of_prior=True)
    depth, north, east = (columns[name] for name in COLUMNS)
    common = float(columns[SD_COMMON][0])
    return WaterPrior(depth_m=depth, north_mps=north, east_mps=east, sd_mps=columns[SD], sd_common_mps=common)


def write_profile(path: str | Path, profile: CurrentProfile | WaterPrior) -> None:
    """Write a profile or a prior as CSV that ``read_profile`` or ``read_prior`` reads back bitwise.

    Parameters
    ----------
    path : file to write.
    profile : profile (m/s, NED).
    """
    columns = dict(zip(COLUMNS, (profile.depth_m, profile.north_mps, profile.east_mps), strict=True))
    if profile.sd_mps is not None:
        columns[SD] = profile.sd_mps
    if isinstance(profile, WaterPrior):
        columns[SD_COMMON] = np.full_like(profile.depth_m, profile.sd_common_mps)
    rows = zip(*(column.tolist() for column in columns.values()), strict=True)
    lines = [",".join(columns), *(",".join(map(repr, row)) for row in rows)]
    Path(path).write_text("\n".join(lines) + "\n", encoding="utf-8")


def _read(path: Path, *, of_prior: bool) -> dict[str, Array]:
    """Read the columns of a file by name, each (K,)."""
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
        raise ConfigError(source, "", "no row of numbers below the header: give at least one depth")
    return {name: np.array([row[name] for row in rows]) for name in header}


def _related(row: Mapping[str, float], before: Sequence[Mapping[str, float]], number: int, source: str) -> None:
    """Check a row against the rows before it and its numbers against each other."""
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
    """Return the positions of the columns by name, and the number of lines up to the header."""
    in_comment: tuple[list[str], int] | None = None
    for number, line in enumerate(lines, start=1):
        if line.lstrip().startswith("#"):
            # Text may follow a name, so only the first word of each cell in a comment counts.
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
    """Return the positions of the columns to read: ``sd_mps`` if present, ``sd_common_mps`` only for a prior."""
    for name in COLUMNS:
        if name not in names:
            raise ConfigError(
                source, f"line {number}", f"missing column {name}; the header must name {', '.join(COLUMNS)}"
            )
    if of_prior:
        for name, meaning in (
            (SD, "standard deviation at each depth"),
            (SD_COMMON, "standard deviation of the part that all depths share, the same in every row; 0 for none"),
        ):
            if name not in names:
                raise ConfigError(source, f"line {number}", f"missing column {name}: a prior needs it ({meaning})")
    wanted = (*COLUMNS, *((SD,) if SD in names else ()), *((SD_COMMON,) if of_prior else ()))
    for name in wanted:
        if names.count(name) > 1:
            raise ConfigError(source, f"line {number}", f"column {name} occurs more than once")
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
