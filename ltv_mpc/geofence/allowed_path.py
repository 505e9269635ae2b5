"""Allowed part of a path: the schedule without what lies in zones and margins.

A target inside a zone would wait there for a vehicle that cannot come. So the columns of the schedule within the
required clearance of a zone are left out. Between the last point before a zone and the first one behind it the target
takes the shortest way round the zones (route.py), with the speed that it has beside the zone; where there is no way, it
jumps. A path that ends inside ends at the nearest point that is allowed.

The times of a timed track are those of the user. Its target waits behind a detour or a jump until the time at which it
would be there without the zone, and what lies behind a long detour is late.

An obstacle at anchor blocks a path as a zone does: a target behind it would wait there for a vehicle that stands in
front of it. An obstacle that moves will be elsewhere when the vehicle comes, so the reference ignores it, and only the
rows of the QP keep clear of it.
"""

from __future__ import annotations

import itertools
import math
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from ltv_mpc.geofence.route import Router, length_m
from ltv_mpc.geofence.zones import Zones, are_clear, clearances, nearest
from ltv_mpc.messages import Array, Pair
from ltv_mpc.references.schedule import DEPTH, EAST, NORTH, TIME, WAY, Schedule

ROUNDING_M = 1e-6
"""Distance by which a point is moved beyond the required clearance, so that rounding does not leave it inside."""

STEP_M = 0.25
"""Largest distance between two columns: a timed track may have longer ones, which could step over a zone."""

SPEED_M, MIN_SPEED_MPS = 2.0, 0.05
"""Length to both sides of a detour of which the largest speed is that of the detour, and its speed if none moves."""

DETOUR_ENDS = np.array([0.0, 0.25, 0.5, 1.0])
"""Distances from the zone, in required clearances, at which a detour may leave the path and meet it again."""

MAX_COLUMNS = 100_000
"""Largest number of columns of a schedule whose steps were divided."""

PROJECTIONS = 30
"""Largest number of projections to one zone after the other."""

DIRECTIONS = 64
"""Directions in which an allowed point is searched where the projections find none."""


NO_ZONES = Zones(np.empty((0, 2)), np.zeros(1, dtype=np.int64), np.empty(0), np.empty(0), np.empty((0, 3)))
"""Zones without a fence."""

MOVED = 0.1
"""Share of its required clearance by which an obstacle may move before the ways are computed again."""


Columns: TypeAlias = npt.NDArray[np.int64]


def allowed_path(
    schedule: Schedule, router: Router, table: Array | None = None, clear: npt.NDArray[np.bool_] | None = None
) -> tuple[Schedule, float]:
    """Return the schedule with detours for its columns that are nearer to a zone than the required clearance.

    Parameters
    ----------
    schedule : motion of the target.
    router : has the zones of the fence and the required clearance.
    table : (5, M) ``divided`` table of the schedule, if it is known.
    clear : (M,) which of its columns keep the required clearance, if that is known.

    Returns
    -------
    The schedule, and the length that is left out or, if that is more, the distance by which the end is moved (m). A
    path whose end has no allowed point near it stays as it is.
    """
    zones, need, keeps_time = router.zones, router.need, schedule.keeps_time
    table = divided(schedule.table) if table is None else table
    clear = are_clear(zones, need, _points(table)) if clear is None else clear
    if clear.all():
        return schedule, 0.0
    # Far from what is left out the path stays as it is, but for its times.
    reach_m = np.array([-1.0, 1.0]) * (SPEED_M + need.max())
    first, last = np.searchsorted(table[WAY], table[WAY, np.flatnonzero(~clear)[[0, -1]]] + reach_m)
    ends = max(int(first) - 1, 0), min(int(last) + 1, table.shape[1])
    begin_s, end_s = float(table[TIME, 0]), float(table[TIME, -1])
    before, table, behind = np.split(table, ends, axis=1)
    kept = np.flatnonzero(clear[slice(*ends)])
    left = table[:, kept].copy()
    step_s, step_m = np.diff(left[TIME]), np.diff(left[WAY])
    gap = np.diff(kept) > 1
    skipped_m = float(table[WAY, -1] - table[WAY, 0] - step_m[~gap].sum())
    if not keeps_time:
        first_s = table[TIME, 0] if ends[0] else 0.0
        left[TIME] = first_s + np.concatenate([[0.0], np.cumsum(np.where(gap, 0.0, step_s))])[: len(kept)]
    if not len(kept) or kept[-1] != table.shape[1] - 1:
        whole_end = float(table[NORTH, -1]), float(table[EAST, -1])
        end = nearest_allowed(zones, need, whole_end)
        if end is None:
            return schedule, 0.0
        skipped_m = max(skipped_m, math.dist(end, whole_end))
        last = table[:, -1:].copy()
        last[TIME], last[NORTH], last[EAST] = left[TIME, -1] if len(kept) else 0.0, *end
        left = np.hstack([left, last] if len(kept) else [last, last])
    elif len(kept) == 1:
        left = np.hstack([left, left])
    # No detour sinks faster than the path beside it and what is left out of it.
    moves = np.diff(table[TIME]) > 0.0
    sinking_mps = np.abs(np.nan_to_num(np.diff(table[DEPTH])))[moves] / np.diff(table[TIME])[moves]
    largest_mps = float(np.max(sinking_mps, initial=0.0))
    left = _with_detours(left, np.flatnonzero(gap), router, largest_mps, keeps_time=keeps_time)
    delay_s = left[TIME, -1] - table[TIME, -1]
    left = np.hstack([before, left, behind])
    left[TIME, left.shape[1] - behind.shape[1] :] += delay_s
    if keeps_time:
        left = _with_rests(left, begin_s, end_s)
    return schedule._replace(table=left), skipped_m


def _with_detours(table: Array, gaps: Columns, router: Router, sinking_mps: float, *, keeps_time: bool) -> Array:
    """Return the table (5, M) of a schedule with the ways round the zones behind the columns ``gaps``.

    They sink at most at ``sinking_mps``. With ``keeps_time`` the target waits behind a gap until the time of the table.
    """
    parts, begin, delay_s = [], 0, 0.0
    ends = np.append(gaps, table.shape[1] - 1)
    for i, following in itertools.pairwise(ends):
        before, behind, way = _shortest_detour(table, range(begin, i + 1), range(i + 1, following + 1), router)
        first, last = table[:, before, None], table[:, behind, None].copy()
        planned_s = float(last[TIME, 0] - first[TIME, 0])
        detour_s = 0.0 if way is None else length_m(way) / _speed_mps(table, before, behind)
        if sinking_mps > 0.0:
            detour_s = max(detour_s, abs(float(last[DEPTH, 0] - first[DEPTH, 0])) / sinking_mps)
        last[TIME] = first[TIME] + detour_s
        parts.append(_later(table[:, begin : before + 1], delay_s))
        if way is not None:
            parts.append(_later(_detour(first, last, way), delay_s))
        if keeps_time:
            parts.append(_later(last, delay_s))
            detour_s = max(detour_s, planned_s - delay_s)
        begin = behind
        delay_s += detour_s - planned_s
    return np.hstack([*parts, _later(table[:, begin:], delay_s)])


def _detour(first: Array, last: Array, way: Array) -> Array:
    """Return the columns (5, K) of a uniform motion along a way (P, 2) between two columns (5, 1)."""
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(way, axis=0).T))])
    at = np.linspace(0.0, along[-1], max(math.ceil(along[-1] / STEP_M), 2) + 1)[1:-1]
    detour: Array = first + (last - first) * (at / along[-1])
    detour[NORTH], detour[EAST] = np.interp(at, along, way[:, 0]), np.interp(at, along, way[:, 1])
    return detour


def _with_rests(table: Array, begin_s: float, end_s: float) -> Array:
    """Return the table (5, M) of a schedule with rests at its ends, from ``begin_s`` and until ``end_s`` at least."""
    ends = table[:, [0, -1]]
    ends[TIME] = min(begin_s, table[TIME, 0]), max(end_s, table[TIME, -1])
    return np.hstack([ends[:, :1], table, ends[:, 1:]])


def _shortest_detour(table: Array, left: range, right: range, router: Router) -> tuple[int, int, Array | None]:
    """Return the columns of ``left`` and ``right`` between which the detour makes the path shortest, and its points.

    The detour may leave the path, and meet it again, up to one required clearance from the zone. None: there is no way.
    """
    best: tuple[int, int, Array | None] = (left[-1], right[0], None)
    best_m, clearance_m = math.inf, float(router.need.max())
    for leave_m in DETOUR_ENDS * clearance_m:
        i = max(left[0], int(np.searchsorted(table[WAY, : left[-1] + 1], table[WAY, left[-1]] - leave_m)))
        for meet_m in DETOUR_ENDS * clearance_m:
            j = min(right[-1], right[0] + int(np.searchsorted(table[WAY, right[0] :], table[WAY, right[0]] + meet_m)))
            start, end = table[[NORTH, EAST], i], table[[NORTH, EAST], j]
            way = np.vstack([start, router.way(start, end, remember=False)])
            longer_m = length_m(way) - float(table[WAY, j] - table[WAY, i])
            if (way[-1] == end).all() and longer_m < best_m - ROUNDING_M:
                best_m, best = longer_m, (i, j, way)
    return best


def _speed_mps(table: Array, before: int, behind: int) -> float:
    """Return the largest speed (m/s) beside the detour between two columns: at a corner or at rest it is small."""
    way = table[WAY]
    first, last = np.searchsorted(way, [way[before] - SPEED_M, way[behind] + SPEED_M])
    step_s, step_m = np.diff(table[TIME, first : last + 1]), np.diff(way[first : last + 1])
    moves = (step_s > 0.0) & (step_m > 0.0)  # on a path at a speed, the part that is left out takes no time
    return float(np.max(step_m[moves] / step_s[moves])) if moves.any() else MIN_SPEED_MPS


def _later(table: Array, delay_s: float) -> Array:
    """Return the table of a schedule that is later by a delay (s)."""
    later = table.copy()
    later[TIME] += delay_s
    return later


def nearest_allowed(zones: Zones, need: Array, point: Pair) -> Pair | None:
    """Return the nearest point with the required clearance from all zones; None if none is found.

    It is projected to the boundary of the zone that it violates most, up to ``PROJECTIONS`` times. Where zones or walls
    are too close to each other for that, it is searched on circles around it.

    Parameters
    ----------
    zones : zones of the fence.
    need : (Z,) required clearance (m).
    point : north and east (m).
    """
    north, east = point
    for _ in range(PROJECTIONS):
        lack = need - clearances(zones, np.array([[north, east]]))[0]
        z = int(np.argmax(lack))
        if lack[z] <= 0.0:
            return north, east
        _, mn, me, qn, qe = nearest(zones, z, north, east)
        north, east = qn + (need[z] + ROUNDING_M) * mn, qe + (need[z] + ROUNDING_M) * me
    angle = 2.0 * math.pi * np.arange(DIRECTIONS) / DIRECTIONS
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    extent = np.ptp(zones.vertices, axis=0).max() + 2.0 * float((need + zones.radius).max())
    for radius in np.geomspace(extent * 1e-3, 2.0 * extent, 200):
        around = np.array(point) + radius * ring
        found = np.flatnonzero(are_clear(zones, need, around))
        if len(found):
            return float(around[found[0], 0]), float(around[found[0], 1])
    return None


def divided(table: Array) -> Array:
    """Return the table (5, M) of a schedule with its steps divided into parts of at most ``STEP_M``.

    Parameters
    ----------
    table : (5, K) table of the schedule.
    """
    lengths = np.diff(table[WAY])
    step_m = max(STEP_M, float(lengths.sum()) / MAX_COLUMNS)
    parts = np.maximum(np.ceil(lengths / step_m), 1.0).astype(np.int64)
    first = np.concatenate([[0], np.cumsum(parts)])  # columns of the table among those of the parts
    return np.array([np.interp(np.arange(first[-1] + 1), first, row) for row in table])


def _points(table: Array) -> Array:
    """Return north and east (M, 2) in m of a table, for compiled code."""
    return np.ascontiguousarray(table[[NORTH, EAST]].T)


class Routes:
    """Shortest ways round zones and standing obstacles, and the part of a path that is allowed."""

    def __init__(self) -> None:
        """Begin with nothing in the way."""
        self.router: Router | None = None
        """Shortest ways at the required clearances of this cycle; None if nothing is in the way."""
        self._at_margins: Router | None = None
        self._zones, self._need = NO_ZONES, np.empty(0)
        self._standing = np.empty((0, 3))
        # Last path, its table in small steps, and which of these are clear of the zones.
        self._divided: tuple[Schedule, Array, npt.NDArray[np.bool_]] | None = None
        self._places: Any = None  # tree of the places of these steps; None before a standing obstacle

    def set_zones(self, zones: Zones, need: Array) -> None:
        """Lead round other zones.

        Parameters
        ----------
        zones : zones of the fence.
        need : (Z,) required clearance at the stated margins (m).
        """
        self._zones, self._need, self._divided = zones, need.copy(), None
        self._restart()

    def set_standing(self, standing: Array) -> bool:
        """Lead round other standing obstacles; return True if they differ from those before.

        Parameters
        ----------
        standing : (S, 3) north, east and required clearance of each (m), in a constant order.
        """
        before = self._standing
        if len(before) == len(standing) and (np.abs(standing - before) <= MOVED * before[:, 2:]).all():
            return False
        self._standing = standing
        self._restart()
        return True

    def require(self, need: Array) -> None:
        """Keep other required clearances from the zones, in this cycle.

        Parameters
        ----------
        need : (Z,) required clearance (m).
        """
        zones, required = self._with_standing(need)
        if self.router is None or not self.router.serves(required):
            self.router = Router(zones, required)

    def allowed_path(self, schedule: Schedule) -> tuple[Schedule, float]:
        """Return the part of a schedule outside zones, margins and obstacles, and the length that is left out (m).

        Parameters
        ----------
        schedule : motion of the target.
        """
        if self._at_margins is None:
            return schedule, 0.0
        if self._divided is None or self._divided[0] is not schedule:
            table = divided(schedule.table)
            self._divided, self._places = (schedule, table, are_clear(self._zones, self._need, _points(table))), None
        _, table, clear = self._divided
        if len(self._standing):
            if self._places is None:
                from scipy.spatial import KDTree  # for standing obstacles alone

                self._places = KDTree(_points(table))
            clear = clear.copy()
            for *place, need_m in self._standing.tolist():  # a report looks at the path near them alone
                clear[self._places.query_ball_point(place, need_m)] = False
        return allowed_path(schedule, self._at_margins, table, clear)

    def _restart(self) -> None:
        zones, need = self._with_standing(self._need)
        self.router = self._at_margins = Router(zones, need) if len(need) else None

    def _with_standing(self, need: Array) -> tuple[Zones, Array]:
        """Return the zones and their required clearances, with a zone of no size for each standing obstacle."""
        zones, standing = self._zones, self._standing
        if not len(standing):
            return zones, need
        places, none = standing[:, :2], np.zeros(len(standing))
        first = zones.first[-1] + 1 + np.arange(len(standing))
        points = Zones(places, first, radius=none, margin=none, circle=np.column_stack([places, none]))
        together = Zones._make(np.concatenate(both) for both in zip(zones, points, strict=True))
        return together, np.concatenate([need, standing[:, 2]])
