"""Timed track, from a table of comma-separated values.

Columns t_s, north_m, east_m, and optionally depth_m, in any order; or latitude_deg and longitude_deg instead of north_m
and east_m, relative to the [origin] of the reference. Lines that start with # are comments. Times increase, and the
target moves uniformly between two rows. A row that the vehicle cannot reach in time (cruising speed, curvature of the
track over the length in which the vehicle turns in, descent rate) is reached as soon as possible. Positions that differ
by the noise of a log are smoothed as those of a path (``leg_fit.py``), and outliers, to which the vehicle could not get
and back in time, are left out.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, TypeAlias

import msgspec
import numpy as np
from msgspec import Meta

from ltv_mpc.csv_table import check_bounds
from ltv_mpc.errors import ConfigError, naming
from ltv_mpc.messages import Array, ReferenceStart
from ltv_mpc.references.base import BaseReference
from ltv_mpc.references.geodesy import DEPTH, METRES, read_places
from ltv_mpc.references.leg_fit import Numbers, along, fit_legs, outliers
from ltv_mpc.references.limits import path_limits
from ltv_mpc.references.path import LEAD_IN_M, smooth_curve
from ltv_mpc.references.schedule import TIME, Schedule, fastest_schedule
from ltv_mpc.vehicle.parameters import Vehicle

Row: TypeAlias = Annotated[tuple[float, ...], Meta(min_length=3, max_length=4)]

MAX_ROWS, MOST_NAMED = 20_000, 5
IN_TIME_S = 0.1
"""Delay up to which a row counts as reached in time."""
CORNER_M = 0.4
"""Largest distance of a corner from the path that smooths the rows: the default of a path."""


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
            check_bounds(dict(zip(("t_s", *METRES, DEPTH), row, strict=False)), f"rows[{k}] ")
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
        table, lead_m = self._table(vehicle), 0.0
        lead = table[:, [0, 0] if table[TIME, 0] > 0.0 else [0]]  # the target rests at the first row until its time
        if anchor is not None:
            ends = np.array([[anchor.north_m, anchor.east_m], table[2:4, 0]])
            distance_m = math.dist(*ends)
            if distance_m >= LEAD_IN_M:
                leg, lead_m = smooth_curve(ends, table[4, [0, 0]], np.zeros(1)), distance_m
                lead = fastest_schedule(leg, path_limits(vehicle), descent_rate_mps=self.descent_rate_mps).table
        # the target reaches the first row at its time, or as soon as possible after it
        begin = max(float(table[TIME, 0]), float(lead[TIME, -1]))
        lead[TIME] += begin - lead[TIME, -1]
        lead[TIME, 0] = 0.0
        table[TIME] += begin - table[TIME, 0]
        table[1] += lead_m
        return Schedule(np.concatenate([lead, table[:, 1:]], axis=1), lead_m, keeps_time=True)

    def notes(self, vehicle: Vehicle) -> list[str]:
        """Return sentences about outliers and the rows that the vehicle cannot reach in time.

        Parameters
        ----------
        vehicle : parameters of the vehicle.
        """
        given, (rows, left_out) = np.array(self.rows), self._rows(vehicle)
        t, notes = rows[:, 0], []
        late = self._table(vehicle)[TIME] - t
        if len(left_out):
            off_m = np.hypot(*(given - rows[:, : given.shape[1]])[left_out, 1:3].T)
            notes.append(
                f"{len(left_out)} of {len(t)} rows are left out as outliers, up to {off_m.max():.1f} m beside those "
                f"around them: t_s = {', '.join(f'{at:g}' for at in t[left_out[:MOST_NAMED]])}"
                f"{', ...' * (len(left_out) > MOST_NAMED)}"
            )
        behind = np.flatnonzero(late > IN_TIME_S)
        if len(behind):
            notes.append(
                f"{len(behind)} of {len(t)} rows cannot be reached in time (the vehicle does "
                f"{path_limits(vehicle).cruise_mps:.2f} m/s straight on, less in bends): the first at t_s = "
                f"{t[behind[0]]:g}; the latest by {late.max():.1f} s, the last by {late[-1]:.1f} s"
            )
        return notes

    def _rows(self, vehicle: Vehicle) -> tuple[Array, Numbers]:
        """Return the rows (K, 4), in which outliers are between the rows around them, and the numbers of these."""
        rows = np.array(self.rows)
        if rows.shape[1] == 3:
            rows = np.column_stack([rows, np.full(len(rows), np.nan if self.depth_m is None else self.depth_m)])
        left_out = outliers(rows[:, 1:], CORNER_M, rows[:, 0], path_limits(vehicle).top_mps)
        kept = np.delete(rows, left_out, axis=0)
        for column in (1, 2, 3):
            rows[left_out, column] = np.interp(rows[left_out, 0], kept[:, 0], kept[:, column])
        return rows, left_out

    def _table(self, vehicle: Vehicle) -> Array:
        """Return the table (5, K) of the schedule: each row at its time, or as soon as the vehicle can be there."""
        (rows, _), limits = self._rows(vehicle), path_limits(vehicle)
        fit = fit_legs(rows[:, 1:], CORNER_M, curves=False)
        points = along(fit.ends, fit.at)
        corners = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(fit.ends[:, :2], axis=0).T))])
        way = np.interp(fit.at, np.arange(len(corners)), corners)
        # the largest speed is constant between the places at which a corner is half the turning-in length away
        half_m = 0.5 * limits.turn_in_m
        places = np.unique(np.concatenate([way, corners[1:-1] - half_m, corners[1:-1] + half_m]))
        places = places[(places >= way[0]) & (places <= way[-1])]
        middle = 0.5 * (places[1:] + places[:-1])
        course = np.unwrap(np.arctan2(*np.diff(fit.ends[:, :2], axis=0).T[::-1]))
        ends = course[np.searchsorted(corners[1:-1], [middle - half_m, middle + half_m])]
        needed = np.diff(places) / limits.speed_at(np.abs(ends[1] - ends[0]) / limits.turn_in_m)
        reached = np.interp(way, places, np.concatenate([[0.0], np.cumsum(needed)])) if len(places) > 1 else 0.0 * way
        sinking_s = np.abs(np.nan_to_num(np.diff(points[:, 2], prepend=points[0, 2]))) / self.descent_rate_mps
        needed = np.cumsum(np.maximum(np.diff(reached, prepend=0.0), sinking_s))
        t = needed + np.maximum.accumulate(rows[:, 0] - needed)
        return np.vstack([t, way, points.T])


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
    source = f"{source}: track {path.name}"
    table = read_places(path, "t_s", origin=timed.origin, rows=(2, MAX_ROWS), what="track", source=source)
    rows = tuple(tuple(row[name] for name in ("t_s", *METRES, DEPTH) if name in row) for row in table.values())
    for k, before, after in zip(list(table)[1:], rows, rows[1:], strict=False):
        if after[0] <= before[0]:
            problem = f"must be later than the row before it, {before[0]:g} s"
            raise ConfigError(source, f"line {k} t_s", problem, value=after[0])
    with naming(source):
        return msgspec.structs.replace(timed, file="", rows=rows)
