"""Current profiles as CSV: columns depth_m, v_north_mps, u_east_mps in any order, further columns ignored.

An estimated profile has two more columns, each with one number for north and east, the larger of the two:
    sd_mps         standard deviation of the whole error at that depth (m/s)
    sd_common_mps  standard deviation of the part of the error that all depths share, the same in every row; 0 for none
With both columns a profile can be a prior: depths that a vehicle measured after one surface fix share an error
(sd_common) and have a smaller error of their own, sqrt(sd^2 - sd_common^2).

Depths are strictly increasing, or all decreasing. Rows whose velocities are both NaN are left out above the first and
below the last depth with a current: LADCPs and gliders write them. The profile is constant above its first depth and
below its last. ``csv_table.py`` reads the file.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from ltv_mpc.csv_table import read_table
from ltv_mpc.errors import ConfigError
from ltv_mpc.messages import Array, CurrentProfile, SpeedDeviations

COLUMNS = ("depth_m", "v_north_mps", "u_east_mps")
SD, SD_COMMON = "sd_mps", "sd_common_mps"
_MEANINGS = {
    SD: ": a prior needs it (standard deviation at each depth)",
    SD_COMMON: ": a prior needs it (standard deviation of the part that all depths share, the same in every row; 0 for "
    "none)",
}


def grid_depths(deepest_m: float, cell_m: float) -> Array:
    """Return the depths of a profile with equal cells (m): 0, h, 2h, ... to the first at or below the deepest one.

    Parameters
    ----------
    deepest_m : depth that the profile reaches (m).
    cell_m : height h of a cell (m).
    """
    return cell_m * np.arange(math.ceil(deepest_m / cell_m - 1e-9) + 1, dtype=np.float64)


def check_cells(deepest_m: float, cell_m: float, most: int, source: str, field: str) -> None:
    """Check that a grid of depths has at least one cell and not too many.

    Parameters
    ----------
    deepest_m, cell_m : largest depth and cell size (m).
    most : largest number of cells.
    source, field : of the cell size, for the error.

    Raises
    ------
    ConfigError : it has not.
    """
    if not 1 <= deepest_m / cell_m <= most:
        problem = f"must be <= deepest_m = {deepest_m:g}, and at least {deepest_m / most:g}: at most {most} cells"
        raise ConfigError(source, field, problem, value=cell_m)


class WaterPrior(CurrentProfile, frozen=True, kw_only=True, eq=False):
    """Prior knowledge of the current before a dive.

    ``sd_mps`` is the standard deviation of the whole error of north and of east at each depth. ``sd_common_mps`` is
    that of the part that all depths share; it is at most the smallest ``sd_mps``.
    """

    sd_mps: SpeedDeviations
    sd_common_mps: float


def read_profile(path: str | Path, notes: list[str] | None = None) -> CurrentProfile:
    """Read a current profile; its depths are strictly increasing.

    Parameters
    ----------
    path : of the file.
    notes : receives a sentence about rows in another order and rows without a current.

    Raises
    ------
    ConfigError
        With file, line, field, value and bound.
    """
    depth, north, east, sd, _ = _read(Path(path), of_prior=False, notes=notes)
    return CurrentProfile(depth_m=depth, north_mps=north, east_mps=east, sd_mps=sd)


def read_prior(path: str | Path) -> WaterPrior:
    """Read a current profile as a prior; both columns of standard deviations are required.

    Parameters
    ----------
    path : of the file.

    Raises
    ------
    ConfigError
        With file, line, field, value and bound.
    """
    depth, north, east, sd, common = _read(Path(path), of_prior=True, notes=None)
    return WaterPrior(depth_m=depth, north_mps=north, east_mps=east, sd_mps=sd, sd_common_mps=float(common[0]))


def write_profile(path: str | Path, profile: CurrentProfile) -> None:
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


def _read(path: Path, *, of_prior: bool, notes: list[str] | None) -> list[Any]:
    """Read the columns of a file, each (K,) or None, from the first to the last depth with a current."""
    source, velocities = f"currents {path}", COLUMNS[1:]
    table = read_table(
        path,
        (*COLUMNS, SD, SD_COMMON) if of_prior else COLUMNS,
        what="currents",
        source=source,
        optional=(SD,),
        meanings=_MEANINGS,
        may_be_nan=(*velocities, SD, SD_COMMON),
    )
    rows, changed = list(table.items()), []
    if len(rows) > 1 and rows[0][1]["depth_m"] > rows[-1][1]["depth_m"]:
        rows.reverse()
        changed.append("the depths descend in the file")
    known = [k for k, (_, row) in enumerate(rows) if not all(math.isnan(row[name]) for name in velocities)]
    if not known:
        raise ConfigError(source, "", "no row of numbers below the header: give at least one depth")
    if len(rows) > known[-1] - known[0] + 1:
        rows = rows[known[0] : known[-1] + 1]
        depths = f"{rows[0][1]['depth_m']:g} to {rows[-1][1]['depth_m']:g} m"
        changed.append(f"rows without a current are left out at its ends, it has {depths}")
    for k, (number, row) in enumerate(rows):
        bad = next((name for name, value in row.items() if math.isnan(value)), None)
        if bad is not None:
            raise ConfigError(source, f"line {number} {bad}", "must be a number, and finite", value="nan")
        if k and row["depth_m"] <= rows[k - 1][1]["depth_m"]:
            problem = f"must be below the depth before it, {rows[k - 1][1]['depth_m']:g} m"
            raise ConfigError(source, f"line {number} depth_m", problem, value=row["depth_m"])
        common, of_all = row.get(SD_COMMON, 0.0), rows[0][1].get(SD_COMMON, 0.0)
        where = f"line {number} {SD_COMMON}"
        if common != of_all:
            raise ConfigError(source, where, f"must be the same in every row, as above {of_all:g} m/s", value=common)
        if common > row.get(SD, common):
            raise ConfigError(source, where, f"must be <= {SD} = {row[SD]:g}, of which it is a part", value=common)
    if changed and notes is not None:
        notes.append(f"{source}: {'; '.join(changed)}")
    names = (*COLUMNS, SD, SD_COMMON)
    return [np.array([row[name] for _, row in rows]) if name in rows[0][1] else None for name in names]
