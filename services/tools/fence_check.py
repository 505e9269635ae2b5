"""Check of a reference against a fence: what the controller makes of it, and where there is no way."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple, TypeAlias

import msgspec
import numpy as np
import numpy.typing as npt

from ltv_mpc.geofence.allowed_path import STEP_M, allowed_path
from ltv_mpc.geofence.fence import Fence
from ltv_mpc.geofence.route import Router, length_m
from ltv_mpc.geofence.zones import Zones, clearances, pack_zones
from ltv_mpc.messages import Array, Pair
from ltv_mpc.references.schedule import DEPTH, EAST, NORTH, WAY, Schedule
from services.reporting.plots.fence import boundary

Mask: TypeAlias = npt.NDArray[np.bool_]

MAX_SAMPLES = 5000
"""Largest number of steps; a longer path has longer ones."""


class PathSamples(NamedTuple):
    """Points of a path; a place alone counts as two points."""

    points: Array  # (P, 2) north and east (m)
    at: Array  # (P,) distance from the first point (m)
    way: Array  # (P,) distance along the path, which does not count detours (m)
    depth: Array  # (P,) depth (m), NaN if it is unknown

    def length_where(self, holds: Mask) -> float:
        """Return the length of the path (m) on which a condition (P,) holds."""
        return float(self.way[-1]) / (len(self.way) - 1) * int(np.count_nonzero(holds))


def sample(table: Array) -> PathSamples:
    """Return points of a schedule's table at equal distances."""
    north, east = table[NORTH], table[EAST]
    along = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(north), np.diff(east)))])
    at = np.linspace(0.0, along[-1], min(max(math.ceil(along[-1] / STEP_M), 1), MAX_SAMPLES) + 1)
    points = np.column_stack([np.interp(at, along, north), np.interp(at, along, east)])
    return PathSamples(points, at, np.interp(at, along, table[WAY]), np.interp(at, along, table[DEPTH]))


WIDE_M = 200.0
"""Free distance to a side above which a corridor counts as open."""


class ZoneCheck(msgspec.Struct, frozen=True, kw_only=True):
    """Distance of the path from one zone, where it is least."""

    zone: str
    margin_m: float
    clearance_m: float  # least distance between hull and zone along the path; negative: inside
    way_m: float  # distance along the path at which it is least
    inside_m: float  # length of the path on which the hull is in the zone
    in_margin_m: float  # length of the path on which the hull is in the zone or its margin


class FenceCheck(NamedTuple):
    """Result of the check of a reference against a fence."""

    zones: list[ZoneCheck]
    narrowest: Pair | None  # width of the narrowest corridor of the allowed path, where on the path (m); None: open
    duration_s: float  # of the allowed path
    problems: list[str]
    notes: list[str]


def check_fence(fence: Fence, hull_m: float, schedule: Schedule, start: Pair | None) -> FenceCheck:
    """Check a path, or a point as a schedule of one place, against a fence.

    Parameters
    ----------
    fence : keep-in and keep-out zones.
    hull_m : radius of the circle around the hull (m).
    schedule : motion of the target; it begins at the vehicle, if that is known.
    start : north and east (m) of the vehicle; None: not known.
    """
    packed, zones = pack_zones(fence), list(fence.zones())
    labels, router = [zone.label for zone in zones], Router(packed, hull_m + packed.margin)
    allowed, _ = allowed_path(schedule, router)
    path = sample(schedule.table)
    free = clearances(packed, path.points) - hull_m
    checks = [_zone(zone.label, zone.margin_m, free[:, z], path) for z, zone in enumerate(zones)]
    is_point = schedule.table[WAY, -1] == 0.0
    problems, notes = list[str](), list[str]()
    if start is not None:
        problems += _start_problems(labels, packed.margin, clearances(packed, np.array([start]))[0] - hull_m)
    elif not is_point:
        problems += _start_problems(labels, np.zeros(len(labels)), free[0])
    lacking = free < packed.margin
    if lacking[-1].any():
        ends = "point" if is_point else "end of the path"
        what = f"the {ends} is not allowed ({', '.join(label for z, label in enumerate(labels) if lacking[-1, z])})"
        problems.append(_end_problem(what, schedule, allowed))
    if allowed is not schedule:
        for zone, check, no_way in zip(zones, checks, _blocked(allowed, router, lacking, path.way), strict=True):
            if check.in_margin_m > 0.0:
                (problems if no_way else notes).append(_crossing(check, keep_in=zone.keep_in, no_way=bool(no_way)))
    if is_point and start is not None:
        (goal,) = allowed.table[[NORTH, EAST], -1:].T
        leg = np.vstack([start, router.way(np.array(start), goal, remember=False)])
        if not (leg[-1] == goal).all():
            problems.append(f"there is no way round the zones from the start to ({goal[0]:.1f}, {goal[1]:.1f})")
        elif len(leg) > 2:
            notes.append(f"the way from the start leads round the zones: {length_m(leg):.1f} m")
    narrowest = None if is_point else _narrowest(fence, packed, allowed, hull_m)
    return FenceCheck(checks, narrowest, allowed.duration_s, problems, notes)


def distance(free_m: float) -> str:
    """Return the distance between hull and zone (m), negative beyond the boundary, as text."""
    return f"{free_m:.3g} m" if free_m >= 0.0 else f"{-free_m:.3g} m beyond the boundary"


def _zone(label: str, margin_m: float, free: Array, path: PathSamples) -> ZoneCheck:
    k = int(np.argmin(free))
    return ZoneCheck(
        zone=label,
        margin_m=margin_m,
        clearance_m=float(free[k]),
        way_m=float(path.way[k]),
        inside_m=path.length_where(free < 0.0),
        in_margin_m=path.length_where(free < margin_m),
    )


def _start_problems(labels: list[str], margin: Array, free: Array) -> Iterator[str]:
    """Yield why the vehicle cannot begin where the hull has the distances ``free`` (Z,) from the zones."""
    for label, margin_m, free_m in zip(labels, margin.tolist(), free.tolist(), strict=True):
        if free_m < 0.0:
            yield f"the start is not allowed: hull {distance(free_m)} of {label}"
        elif free_m < margin_m:
            yield f"the start is in the margin of {label}: hull {distance(free_m)} from it, margin {margin_m:g} m"


def _end_problem(what: str, schedule: Schedule, allowed: Schedule) -> str:
    """Return where the vehicle ends instead of an end that is not allowed."""
    if allowed is schedule:
        return f"{what}, and no allowed point is near it"
    end, moved = schedule.table[[NORTH, EAST], -1], allowed.table[[NORTH, EAST], -1]
    place = f"({moved[0]:.1f}, {moved[1]:.1f})"
    return f"{what}: the vehicle holds at {place} instead, {math.dist(end, moved):.1f} m away"


def _blocked(allowed: Schedule, router: Router, lacking: Mask, way: Array) -> Mask:
    """Return True (Z,) for each zone that the target jumps across, because no way leads round it.

    Parameters
    ----------
    allowed : allowed part of the path.
    router : ways round the zones.
    lacking : (P, Z) True for points of the path that are too near to a zone.
    way : (P,) distances of the points along the path (m).
    """
    table, blocked = allowed.table, np.zeros(lacking.shape[1], dtype=bool)
    for k in np.flatnonzero(np.hypot(*np.diff(table[[NORTH, EAST]])) > STEP_M):
        before, behind = np.ascontiguousarray(table[[NORTH, EAST], k : k + 2].T)
        if not (router.way(before, behind, remember=False)[-1] == behind).all():
            blocked |= lacking[(way >= table[WAY, k]) & (way <= table[WAY, k + 1])].any(axis=0)
    return blocked


def _crossing(check: ZoneCheck, *, keep_in: bool, no_way: bool) -> str:
    """Return what becomes of the part of the path in a zone and its margin."""
    length = f"{check.in_margin_m:.1f} m"
    if no_way:
        return f"there is no way round {check.zone}: {length} of the path cannot be followed"
    if keep_in:
        return f"the path leaves {check.zone} or enters its margin: {length} are left out"
    return f"the path lies in {check.zone} or its margin: {length} are left out, and the way leads round it"


def _narrowest(fence: Fence, zones: Zones, allowed: Schedule, hull_m: float) -> Pair | None:
    """Return the least free width (m) across the allowed path and where on the path it is (m); None: open."""
    import shapely  # takes a tenth of a second

    points, at, way, _ = sample(allowed.table)
    if at[-1] == 0.0:
        return None
    along = np.gradient(points, at, axis=0)
    across = np.column_stack([-along[:, 1], along[:, 0]]) / np.maximum(np.hypot(*along.T), 1e-9)[:, None]
    boundaries, width = shapely.MultiLineString([boundary(zone) for zone in fence.zones()]), np.zeros(len(points))
    for side in (WIDE_M, -WIDE_M):
        rays = shapely.linestrings(np.stack([points, points + side * across], axis=1))
        width += np.nan_to_num(shapely.distance(shapely.points(points), rays & boundaries), nan=math.inf)
    width[clearances(zones, points).min(axis=1) < hull_m] = math.inf  # in a zone: there is no corridor
    k = int(np.argmin(width))
    return (float(width[k]), float(way[k])) if math.isfinite(width[k]) else None
