"""Reference across a zone: the schedule skips what lies in zones and margins, and distances go round them.

A target inside a zone would wait there for a vehicle that cannot come. So the columns of the schedule within the
required clearance of a zone are left out: behind the last point before a zone comes the first one behind it, without a
time between. The target waits there for the vehicle, whose distance is measured round the zone. A path that ends inside
ends at the nearest point that is allowed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ltv_mpc.geofence.zones import Zones, clearances, nearest
from ltv_mpc.messages import Array, Pair
from ltv_mpc.references.schedule import EAST, NORTH, TIME, WAY, Schedule

ROUNDING_M = 1e-6
"""Distance by which a point is moved beyond the required clearance, so that rounding does not leave it inside."""

PROJECTIONS = 30
"""Largest number of projections to one zone after the other."""

DIRECTIONS = 64
"""Directions in which an allowed point is searched where the projections find none."""

CORNERS = 32
"""Corners of the polygon around a circle."""


class Skipped(NamedTuple):
    """Schedule without what lies in zones and margins."""

    schedule: Schedule
    skipped_m: float  # length of the path that is left out
    gaps: int  # places inside the path at which the target continues from the exit


def skip_zones(schedule: Schedule, zones: Zones, need: Array) -> Skipped:
    """Return the schedule without its columns nearer to a zone than the required clearance.

    Parameters
    ----------
    schedule : motion of the target.
    zones : zones of the fence.
    need : (Z,) required clearance (m).

    Raises
    ------
    ValueError
        No point of the path is allowed, and none is near its end.
    """
    table = schedule.table
    points = np.ascontiguousarray(table[[NORTH, EAST]].T)
    kept = np.flatnonzero((clearances(zones, points) >= need).all(axis=1))
    if len(kept) == table.shape[1]:
        return Skipped(schedule, 0.0, 0)
    left = table[:, kept].copy()
    step_s, step_m = np.diff(left[TIME]), np.diff(left[WAY])
    gap = np.diff(kept) > 1
    skipped_m = float(table[WAY, -1] - table[WAY, 0] - step_m[~gap].sum())
    left[TIME] = np.concatenate([[0.0], np.cumsum(np.where(gap, 0.0, step_s))])[: len(kept)]
    if not len(kept) or kept[-1] != table.shape[1] - 1:
        end = nearest_allowed(zones, need, (float(points[-1, 0]), float(points[-1, 1])))
        if end is None:
            raise ValueError("the path ends in a zone or its margin, and no allowed point is near its end")
        last = table[:, -1:].copy()
        last[TIME], last[NORTH], last[EAST] = left[TIME, -1] if len(kept) else 0.0, *end
        left = np.hstack([left, last] if len(kept) else [last, last])
    return Skipped(schedule._replace(table=np.ascontiguousarray(left)), skipped_m, int(np.count_nonzero(gap)))


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
        found = np.flatnonzero((clearances(zones, around) >= need).all(axis=1))
        if len(found):
            return float(around[found[0], 0]), float(around[found[0], 1])
    return None


def distance_round_m(zones: Zones, need: Array, start: Pair, end: Pair) -> float:
    """Return the length (m) of a way between two points that goes round each keep-out zone between them.

    It is the straight line, longer for each zone on it by the shorter way round. Round a concave zone it follows the
    convex hull. Keep-in zones do not count.

    Parameters
    ----------
    zones : zones of the fence.
    need : (Z,) required clearance (m).
    start, end : north and east (m).
    """
    straight = math.dist(start, end)
    longer = 0.0
    for z in range(len(zones.radius)):
        if np.isfinite(zones.circle[z, 2]):
            longer += min(ways_round_m(zones, z, float(need[z]), start, end)) - straight
    return straight + longer


def ways_round_m(zones: Zones, z: int, need_m: float, start: Pair, end: Pair) -> tuple[float, float]:
    """Return the lengths (m) of the shortest ways past a zone, to port and to starboard of it.

    They are the two sides of the convex hull of the zone, grown by the required clearance, and both points. If the zone
    is not between the points, one of them is the straight line. A point inside the grown zone counts as on its hull.

    Parameters
    ----------
    zones : zones of the fence.
    z : number of a keep-out zone.
    need_m : required clearance (m).
    start, end : north and east (m).
    """
    angle = 2.0 * math.pi * (np.arange(CORNERS) + 0.5) / CORNERS
    # the polygon has the perimeter of the circle
    radius = (zones.radius[z] + need_m) * math.pi / (CORNERS * math.sin(math.pi / CORNERS))
    circle = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    vertices = zones.vertices[zones.first[z] : zones.first[z + 1]]
    grown = (vertices[:, None] + circle).reshape(-1, 2)
    way = np.array(end) - start
    side = way[0] * (grown[:, 1] - start[1]) - way[1] * (grown[:, 0] - start[0])  # positive to starboard
    port, starboard = (_bent_m(start, end, grown[sign * side > 0.0]) for sign in (-1.0, 1.0))
    if _is_between(grown, start, end):
        return port, starboard
    straight = math.dist(start, end)
    return (straight, starboard) if (side > 0.0).mean() > 0.5 else (port, straight)


def _is_between(grown: Array, start: Pair, end: Pair) -> bool:
    """Return True if the line between two points crosses the convex hull of a zone's grown vertices."""
    hull = _hull(grown.tolist())
    way, n = np.array(end) - start, len(hull)
    # clip the line by the half-planes of the hull's edges (Cyrus & Beck 1978)
    low, high = 0.0, 1.0
    for i in range(n):
        edge = np.array(hull[(i + 1) % n]) - hull[i]
        inward = np.array([-edge[1], edge[0]])
        at, slope = inward @ (np.array(start) - hull[i]), inward @ way
        if slope == 0.0:
            if at < 0.0:
                return False
        elif slope > 0.0:
            low = max(low, float(-at / slope))
        else:
            high = min(high, float(-at / slope))
    return low < high


def _bent_m(start: Pair, end: Pair, points: Array) -> float:
    """Return the length (m) of the shortest way between two points that passes outside points on one side of it."""
    hull = _hull([start, end, *points.tolist()])
    length = sum(math.dist(hull[i - 1], hull[i]) for i in range(len(hull)))
    return length - math.dist(start, end)


def _hull(points: Sequence[Sequence[float]]) -> list[Sequence[float]]:
    """Return the convex hull of points, counter-clockwise in the plane of the coordinates (Andrew 1979)."""
    ordered = sorted((float(n), float(e)) for n, e in points)
    if len(ordered) < 3:
        return list(ordered)
    chains = []
    for run in (ordered, ordered[::-1]):
        chain: list[Sequence[float]] = []
        for point in run:
            while len(chain) > 1 and _turn(chain[-2], chain[-1], point) <= 0.0:
                chain.pop()
            chain.append(point)
        chains += chain[:-1]
    return chains


def _turn(a: Sequence[float], b: Sequence[float], c: Sequence[float]) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
