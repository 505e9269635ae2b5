"""Timed track, from a table of comma-separated values.

Columns t_s, north_m, east_m, and optionally depth_m, in any order; or latitude_deg and longitude_deg instead of north_m
and east_m, relative to the [origin] of the reference. Lines that start with # are comments. Times increase, and the
target moves uniformly between two rows. A row that the vehicle cannot reach in time (cruising speed, curvature of the
track) is reached as soon as possible, and all later rows are delayed by the same time.
"""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import Annotated, TypeAlias

import msgspec
import numpy as np
from msgspec import Meta

from ltv_mpc import config
from ltv_mpc.errors import ConfigError
from ltv_mpc.messages import Array, ReferenceStart
from ltv_mpc.references.base import BaseReference
from ltv_mpc.references.geodesy import Place, local
from ltv_mpc.references.limits import path_limits
from ltv_mpc.references.path import Path as Track
from ltv_mpc.references.path import with_lead_in
from ltv_mpc.references.schedule import TIME, Schedule, fastest_schedule
from ltv_mpc.references.shapes import LEAD_IN_M
from ltv_mpc.vehicle.parameters import Vehicle

Row: TypeAlias = Annotated[tuple[float, ...], Meta(min_length=3, max_length=4)]

METRES = ("north_m", "east_m")
DEGREES = ("latitude_deg", "longitude_deg")
MAX_ROWS = 20_000
MAX_TIME_S = 1e6
IN_TIME = 0.99
"""Share of the time between two rows: a step that needs at most 1 / IN_TIME of its time counts as in time."""


class Timed(BaseReference, frozen=True, kw_only=True, tag="timed"):
    """Track with a time for each row; ``file`` is a CSV in the folder of the reference file, ``rows`` the same inline.

    ``rows``: t_s since the start, north_m, east_m, and depth_m in all rows or in none.
    """

    file: str = ""
    rows: Annotated[tuple[Row, ...], Meta(max_length=MAX_ROWS)] = ()

    def __post_init__(self) -> None:
        """Reject rows that are out of bounds or out of order, and fields that contradict each other."""
        if bool(self.file) == bool(self.rows):
            raise ValueError("give either file (a CSV) or rows")
        if not self.rows:
            return
        if len(self.rows) < 2 or len({len(row) for row in self.rows}) > 1:
            raise ValueError("rows: at least 2, all with the same number of columns")
        for k, row in enumerate(self.rows):
            _check_bounds(dict(zip(("t_s", *METRES, "depth_m"), row, strict=False)), f"rows[{k}] ")
        t = [row[0] for row in self.rows]
        late = next((k for k in range(1, len(t)) if t[k] <= t[k - 1]), None)
        if late is not None:
            raise ValueError(f"rows[{late}] t_s = {t[late]:g}: must be later than the row before it, {t[late - 1]:g} s")
        if self.depth_m is not None and len(self.rows[0]) == 4:
            raise ValueError("depth_m is given for the whole track and in its rows: remove one of them")

    def schedule(self, vehicle: Vehicle, anchor: ReferenceStart | None = None) -> Schedule:
        """Return the schedule of the rows, delayed where the vehicle is not fast enough.

        Parameters
        ----------
        vehicle : parameters of the vehicle, which limit the speed.
        anchor : start of the reference, from which a straight leg leads to the first row; None: start at that row.
        """
        table, length = self._table(vehicle)
        if table[TIME, 0] > 0.0:  # until then the target rests at the first row
            first = table[:, :1].copy()
            first[TIME] = 0.0
            table, length = np.concatenate([first, table], axis=1), np.concatenate([[0.0], length])
        track = Track(table[2:4].T, table[4], np.zeros(len(length)), np.zeros(len(length)), np.zeros(len(length) + 1))
        if anchor is None:
            return Schedule(table, 0.0)
        start = np.array([anchor.north_m, anchor.east_m])
        moved, lead_m = with_lead_in(track, start, LEAD_IN_M)
        if lead_m == 0.0:
            return Schedule(table, 0.0)
        leg = Track(moved.points[:2], moved.depth[:2], np.zeros(1), np.zeros(1), np.zeros(2))
        limits = path_limits(vehicle)
        lead = fastest_schedule(leg, limits.cruise_mps, limits, descent_rate_mps=self.descent_rate_mps).table
        # the target reaches the first row at its time, or as soon as possible after it
        begin = max(float(table[TIME, 0]), float(lead[TIME, -1]))
        lead[TIME] += begin - lead[TIME, -1]
        table[TIME] += begin - table[TIME, 0]
        table[1] += lead_m
        lead[TIME, 0] = 0.0
        return Schedule(np.concatenate([lead, table[:, 1:]], axis=1), lead_m)

    def notes(self, vehicle: Vehicle) -> list[str]:
        """Return a sentence about the rows that the vehicle cannot reach in time.

        Parameters
        ----------
        vehicle : parameters of the vehicle.
        """
        table, _ = self._table(vehicle)
        t = np.array([row[0] for row in self.rows])
        late = table[TIME] - t
        if late[-1] <= 1e-6:
            return []
        step = np.diff(late)
        return [
            f"{np.count_nonzero(step > 1e-6)} of {len(step)} rows cannot be reached in time (the vehicle does "
            f"{path_limits(vehicle).cruise_mps:.2f} m/s straight on, less in bends): the first at t_s = "
            f"{t[1:][step > 1e-6][0]:g}; the last row is reached {late[-1]:.1f} s late"
        ]

    def _table(self, vehicle: Vehicle) -> tuple[Array, Array]:
        """Return the table (5, M) of the schedule, and the lengths (M-1,) of its steps (m)."""
        rows = np.array(self.rows)
        steps = np.diff(rows[:, 1:3], axis=0)
        length = np.hypot(*steps.T)
        limits = path_limits(vehicle)
        needed = length / limits.speed_at(_curvature(steps, length))
        asked = np.diff(rows[:, 0])
        took = np.where(needed > asked / IN_TIME, needed, asked)
        table = np.empty((5, len(rows)))
        table[0] = rows[0, 0] + np.concatenate([[0.0], np.cumsum(took)])
        table[1] = np.concatenate([[0.0], np.cumsum(length)])
        table[2:4] = rows[:, 1:3].T
        table[4] = rows[:, 3] if rows.shape[1] == 4 else (math.nan if self.depth_m is None else self.depth_m)
        return table, length


def _curvature(steps: Array, length: Array) -> Array:
    """Return the curvature (M-1,) in 1/m of each step, the larger of those at its ends.

    At a corner it is 2 tan(phi / 2) over the mean length of the two steps.
    """
    at = np.zeros(len(steps) + 1)
    moving = length > 1e-9
    course = np.arctan2(steps[:, 1], steps[:, 0])
    turn = np.abs(np.remainder(np.diff(course) + np.pi, 2.0 * np.pi) - np.pi)
    both = moving[1:] & moving[:-1]
    mean = np.where(both, 0.5 * (length[1:] + length[:-1]), 1.0)
    at[1:-1] = np.where(both, 2.0 * np.tan(0.5 * np.minimum(turn, 3.0)) / mean, 0.0)
    return np.maximum(at[1:], at[:-1])


def from_csv(timed: Timed, path: Path, *, source: str) -> Timed:
    """Return the track with the rows of its file.

    Parameters
    ----------
    timed : track that names the file.
    path : the file.
    source : name of the reference, for error messages.

    Raises
    ------
    ConfigError
        If the file cannot be read or a row is not valid.
    """
    text = config.read_text(path, what="track")
    source = f"{source}: track {path.name}"
    lines = [(k, line) for k, line in enumerate(text.splitlines(), start=1) if line.strip()]
    lines = [(k, line) for k, line in lines if not line.lstrip().startswith("#")]
    header = _header(lines[0][1], source) if lines else {}
    if len(lines) < 3:
        raise ConfigError(source, "", "needs a header and two rows of numbers")
    if len(lines) - 1 > MAX_ROWS:
        raise ConfigError(source, "", f"has {len(lines) - 1} rows: at most {MAX_ROWS}")
    rows = tuple(_row(line, f"line {k} ", header, timed, source) for k, line in lines[1:])
    for (k, _), before, after in zip(lines[2:], rows, rows[1:], strict=False):
        if after[0] <= before[0]:
            problem = f"must be later than the row before it, {before[0]:g} s"
            raise ConfigError(source, f"line {k} t_s", problem, value=after[0])
    try:
        return msgspec.structs.replace(timed, file="", rows=rows)
    except ValueError as error:
        raise ConfigError(source, "", str(error)) from None


def _header(line: str, source: str) -> dict[str, int]:
    names = [cell.strip() for cell in next(csv.reader([line]), [])]
    place = DEGREES if DEGREES[0] in names else METRES
    for name in ("t_s", *place):
        if name not in names:
            problem = "the header must name t_s, north_m, east_m (or latitude_deg, longitude_deg), optionally depth_m"
            raise ConfigError(source, "", f"missing column {name}; {problem}")
    for name in names:
        if names.count(name) > 1:
            raise ConfigError(source, "", f"column {name} occurs twice")
    return {name: names.index(name) for name in ("t_s", *place, "depth_m") if name in names}


def _row(line: str, where: str, header: dict[str, int], timed: Timed, source: str) -> tuple[float, ...]:
    """Return t_s, north_m, east_m, and depth_m if there is such a column."""
    cells = next(csv.reader([line]), [])
    values: dict[str, float] = {}
    for name, position in header.items():
        if position >= len(cells):
            raise ConfigError(
                source, f"{where}{name}", f"missing: column {position + 1} of a line that has {len(cells)}"
            )
        cell = cells[position].strip()
        try:
            values[name] = float(cell) if "_" not in cell else math.nan  # Python accepts 1_0 as ten
        except ValueError:
            values[name] = math.nan
        if not math.isfinite(values[name]):
            raise ConfigError(source, f"{where}{name}", "must be a number", value=cell[:40])
    try:
        _check_bounds(values, where)
        if DEGREES[0] in values:
            place = Place(latitude_deg=values[DEGREES[0]], longitude_deg=values[DEGREES[1]])
            values["north_m"], values["east_m"] = local(place, timed.origin)
    except ValueError as error:
        raise ConfigError(source, "", str(error)) from None
    return tuple(values[name] for name in ("t_s", *METRES, "depth_m") if name in values)


_BOUNDS = {
    "t_s": (0.0, MAX_TIME_S),
    "north_m": (-1e6, 1e6),
    "east_m": (-1e6, 1e6),
    "latitude_deg": (-89.0, 89.0),
    "longitude_deg": (-180.0, 180.0),
    "depth_m": (0.0, 11_000.0),
}


def _check_bounds(values: dict[str, float], where: str) -> None:
    """Raise ``ValueError`` if a number is out of bounds."""
    for name, value in values.items():
        low, high = _BOUNDS[name]
        if not low <= value <= high:
            raise ValueError(f"{where}{name} = {value:g}: must be >= {low:g} and <= {high:g}")
