"""Check of a mission before it begins: a reference, a fence and a current, for one vehicle, with numbers."""

from __future__ import annotations

import math

import msgspec
import numpy as np

from ltv_mpc.bathymetry import Bathymetry
from ltv_mpc.control.config import MotionLimits
from ltv_mpc.errors import ConfigError
from ltv_mpc.geofence.fence import Fence
from ltv_mpc.geofence.zones import Zones, clearances, pack_zones
from ltv_mpc.messages import Array, Estimate
from ltv_mpc.references import Hold, Point, Reference
from ltv_mpc.references.limits import path_limits
from ltv_mpc.vehicle.parameters import Vehicle
from ltv_mpc.vehicle.performance import performance, stopping

STEP_M = 0.25
"""Distance between two samples of the path."""

MAX_SAMPLES = 5000
"""Largest number of samples; a longer path is sampled more coarsely."""

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


class BottomCheck(msgspec.Struct, frozen=True, kw_only=True):
    """Altitude of the reference above the bottom of a bathymetry, where it is least."""

    altitude_m: float  # negative: below the bottom
    depth_m: float  # of the reference
    way_m: float  # distance along the path
    north_m: float
    east_m: float
    too_deep_m: float  # length of the path on which the altitude is less than min_altitude_m
    unknown_m: float  # length of the path on which the bottom is not known


class MissionCheck(msgspec.Struct, frozen=True, kw_only=True):
    """Result of the check of a mission."""

    length_m: float
    duration_s: float
    largest_depth_m: float | None  # that the reference asks for
    current_mps: float
    drift_m: float | None  # while the vehicle turns into the current by 90 degrees; null: it cannot turn
    stopping_m: float | None  # from the speed of the reference, with the drift meanwhile; null: it does not stop
    corridor_m: float | None  # narrowest free width along the path; null: open
    needed_m: float | None  # width that the vehicle needs: hull, two margins and the drift
    bottom: BottomCheck | None  # null: without a bathymetry, or the bottom is not known below the reference
    zones: list[ZoneCheck]
    problems: list[str]  # what cannot be


def check_mission(
    vehicle: Vehicle,
    reference: Reference,
    fence: Fence | None,
    *,
    current_mps: float = 0.0,
    bottom_m: float | None = None,
    bathymetry: Bathymetry | None = None,
    limits: MotionLimits | None = None,
) -> MissionCheck:
    """Check a reference against a fence, a current and the depths.

    Parameters
    ----------
    vehicle : its file needs [hull] if there is a fence.
    reference : path or point; of "here" only the depth is checked.
    fence : None: only current and depths are checked.
    current_mps : speed of the water, from any direction.
    bottom_m : depth of the bottom; None: not known.
    bathymetry : soundings of the bottom; None: none.
    limits : limits of the controller's settings: depths and cross-track distance.
    """
    points, depth, way, duration_s, speed_mps = _samples(vehicle, reference)
    largest = None if np.isnan(depth).all() else float(np.nanmax(depth))
    can = performance(vehicle)
    drift_m = None if can.turn_90deg_s is None else current_mps * can.turn_90deg_s
    stop = stopping(vehicle, speed_mps) if speed_mps > 0.0 else (0.0, 0.0)
    stopping_m = None if stop is None else stop[0] + current_mps * stop[1]
    problems = _current_problems(vehicle, reference, current_mps)
    limits = limits or MotionLimits()
    problems += _corridor_problems(reference, limits.max_cross_track_m, drift_m, current_mps)
    bottom, too_deep = _check_bottom(bathymetry, points, depth, way, limits)
    problems += _depth_problems(largest, bottom_m, limits) + too_deep
    zones, corridor_m, needed_m = [], None, None
    if fence is not None and len(points):
        hull_m = _hull_radius_m(vehicle)
        packed = pack_zones(fence)
        free = clearances(packed, points) - hull_m
        zones = [_zone(zone.label, zone.margin_m, free[:, z], way) for z, zone in enumerate(fence.zones())]
        problems += _zone_problems(zones, free[0], stopping_m, speed_mps)
        if drift_m is not None:
            needed_m = 2.0 * hull_m + 2.0 * float(packed.margin.max()) + drift_m
            width = _corridor(packed, points, way)
            k = int(np.argmin(width))
            corridor_m = float(width[k]) if math.isfinite(width[k]) else None
            if width[k] < needed_m and free[k].min() >= 0.0:
                problems.append(
                    f"the corridor is {width[k]:.1f} m wide at {way[k]:.0f} m of the path: the vehicle needs "
                    f"{needed_m:.1f} m, hull and two margins and {drift_m:.1f} m of drift while it turns into "
                    f"{current_mps:g} m/s"
                )
    return MissionCheck(
        length_m=float(way[-1]) if len(way) else 0.0,
        duration_s=duration_s,
        largest_depth_m=largest,
        current_mps=current_mps,
        drift_m=drift_m,
        stopping_m=stopping_m,
        corridor_m=corridor_m,
        needed_m=needed_m,
        bottom=bottom,
        zones=zones,
        problems=problems,
    )


def table(of: MissionCheck) -> str:
    """Format the result as text."""
    depth = "" if of.largest_depth_m is None else f", down to {of.largest_depth_m:g} m"
    lines = [f"mission: {of.length_m:.0f} m in {of.duration_s:.0f} s{depth}, current {of.current_mps:g} m/s"]
    rows = [
        ("drift while turning into the current", _metres(of.drift_m)),
        ("stopping distance with drift", _metres(of.stopping_m)),
    ]
    if of.zones:
        rows.append(("narrowest corridor", "open" if of.corridor_m is None else f"{of.corridor_m:.3g} m"))
        rows.append(("width that the vehicle needs", _metres(of.needed_m)))
    if of.bottom is not None:
        rows.append(("altitude of the reference", f"{of.bottom.altitude_m:.3g} m or more, {_place(of.bottom)}"))
    for zone in of.zones:
        where = f"{zone.clearance_m:.3g} m at {zone.way_m:.0f} m of the path, margin {zone.margin_m:g} m"
        rows.append((f"hull from {zone.zone}", where))
    lines += [f"  {name:<38}{value}" for name, value in rows]
    lines += [f"  problem: {problem}" for problem in of.problems] or ["  no problems"]
    return "\n".join(lines)


def _metres(value: float | None) -> str:
    return "none" if value is None else f"{value:.3g} m"


def _samples(vehicle: Vehicle, reference: Reference) -> tuple[Array, Array, Array, float, float]:
    """Return points (P, 2), depths (P,) and distances (P,) along the path (m), its duration (s) and speed (m/s)."""
    if isinstance(reference, Point | Hold):
        depth = np.array([math.nan if reference.depth_m is None else reference.depth_m])
        if isinstance(reference, Hold):
            return np.empty((0, 2)), depth, np.empty(0), 0.0, 0.0
        place = reference.position(reference.anchor(Estimate.at_rest()))
        return np.array([place]), depth, np.zeros(1), 0.0, 0.0
    schedule = reference.schedule(vehicle)
    t, s, north, east, depth = schedule.table
    count = min(max(math.ceil(schedule.length_m / STEP_M), 1), MAX_SAMPLES)
    way = np.linspace(0.0, s[-1], count + 1)
    points = np.column_stack([np.interp(way, s, north), np.interp(way, s, east)])
    moving = np.diff(t) > 0.0
    speed = np.diff(s)[moving] / np.diff(t)[moving]
    fastest = min(float(speed.max(initial=0.0)), path_limits(vehicle).top_mps)
    return points, np.interp(way, s, depth), way, schedule.duration_s, fastest


def _hull_radius_m(vehicle: Vehicle) -> float:
    if vehicle.hull is None:
        raise ConfigError(f"vehicle {vehicle.name}", "[hull]", "is missing: a fence needs length_m and beam_m")
    return vehicle.hull.radius_m


def _zone(label: str, margin_m: float, free: Array, way: Array) -> ZoneCheck:
    k, step = int(np.argmin(free)), float(way[-1]) / max(len(way) - 1, 1)
    return ZoneCheck(
        zone=label,
        margin_m=margin_m,
        clearance_m=float(free[k]),
        way_m=float(way[k]),
        inside_m=step * int(np.count_nonzero(free < 0.0)),
        in_margin_m=step * int(np.count_nonzero(free < margin_m)),
    )


def _zone_problems(zones: list[ZoneCheck], start: Array, stopping_m: float | None, speed_mps: float) -> list[str]:
    """Return what is wrong at the start, along the path, and with the margins."""
    problems = []
    if stopping_m is None:
        problems.append(f"the vehicle does not stop from {speed_mps:.2f} m/s, so no margin is long enough")
    for zone, free in zip(zones, start.tolist(), strict=True):
        at = f"{zone.clearance_m:.1f} m at {zone.way_m:.0f} m of the path"
        if free < 0.0:
            problems.append(f"the start is not allowed: hull {-free:.1f} m beyond the boundary of {zone.zone}")
        elif zone.clearance_m < 0.0:
            problems.append(f"the path is not allowed for {zone.inside_m:.1f} m of it: {zone.zone}, hull {at}")
        elif zone.clearance_m < zone.margin_m:
            problems.append(
                f"the path enters the margin of {zone.zone} for {zone.in_margin_m:.1f} m of it: hull {at}, margin "
                f"{zone.margin_m:g} m"
            )
        if stopping_m is not None and stopping_m > zone.margin_m and zone.clearance_m < stopping_m:
            problems.append(
                f"{zone.zone}: stopping from {speed_mps:.2f} m/s takes {stopping_m:.1f} m, margin {zone.margin_m:g} m"
            )
    return problems


def _current_problems(vehicle: Vehicle, reference: Reference, current_mps: float) -> list[str]:
    """Return what the current makes impossible."""
    limits, problems = path_limits(vehicle), []
    if current_mps >= limits.cruise_mps:
        problems.append(
            f"a current of {current_mps:g} m/s carries the vehicle away: 80 % of its thrust holds "
            f"{limits.cruise_mps:.2f} m/s, full thrust {limits.top_mps:.2f} m/s"
        )
    if isinstance(reference, Point | Hold) and reference.heading_deg is not None and current_mps > 0.0:
        problems.append(
            f"heading_deg = {reference.heading_deg:g} is not held in a current of {current_mps:g} m/s across it: the "
            "vehicle has no side thrust, and turns to hold its position"
        )
    return problems


def _corridor_problems(
    reference: Reference, half_width_m: float | None, drift_m: float | None, current_mps: float
) -> list[str]:
    """Return why the vehicle cannot keep to its largest cross-track distance."""
    if half_width_m is None or isinstance(reference, Point | Hold):
        return []
    if drift_m is None:
        return [f"max_cross_track_m = {half_width_m:g} is not kept: the vehicle cannot turn into a current"]
    if drift_m <= half_width_m:
        return []
    return [
        f"max_cross_track_m = {half_width_m:g} is not kept: the vehicle drifts {drift_m:.2f} m while it turns into "
        f"{current_mps:g} m/s"
    ]


def _depth_problems(largest: float | None, bottom_m: float | None, limits: MotionLimits) -> list[str]:
    """Return what is wrong with the depths of the reference."""
    if largest is None:
        return []
    problems = []
    if bottom_m is not None:
        altitude_m = limits.min_altitude_m or 0.0
        if largest > bottom_m - altitude_m:
            ends = (
                f"with min_altitude_m = {altitude_m:g} the vehicle stops at {bottom_m - altitude_m:g} m"
                if altitude_m
                else "no min_altitude_m stops the vehicle"
            )
            problems.append(f"the reference descends to {largest:g} m, the bottom is at {bottom_m:g} m: {ends}")
    if limits.max_depth_m is not None and largest > limits.max_depth_m:
        problems.append(f"the reference descends to {largest:g} m: max_depth_m = {limits.max_depth_m:g}")
    return problems


def _check_bottom(
    bathymetry: Bathymetry | None, points: Array, depth: Array, way: Array, limits: MotionLimits
) -> tuple[BottomCheck | None, list[str]]:
    """Return where the altitude of the reference is least, and what is wrong with it."""
    if bathymetry is None or not len(points) or np.isnan(depth).all():
        return None, []
    least_m = limits.min_altitude_m or 0.0
    altitude, step = bathymetry.depths(points) - depth, float(way[-1]) / max(len(way) - 1, 1)
    if np.isnan(altitude).all():
        return None, ["the bathymetry does not reach the reference"]
    k = int(np.nanargmin(altitude))
    bottom = BottomCheck(
        altitude_m=float(altitude[k]),
        depth_m=float(depth[k]),
        way_m=float(way[k]),
        north_m=float(points[k, 0]),
        east_m=float(points[k, 1]),
        too_deep_m=step * int(np.count_nonzero(altitude < least_m)),
        unknown_m=step * int(np.count_nonzero(np.isnan(altitude))),
    )
    problems = []
    if bottom.altitude_m < least_m:
        problems.append(
            f"the reference is too deep for {bottom.too_deep_m:.1f} m of the path, by up to "
            f"{least_m - bottom.altitude_m:.1f} m {_place(bottom)}: depth {bottom.depth_m:.1f} m, bottom "
            f"{bottom.depth_m + bottom.altitude_m:.1f} m, min_altitude_m = {least_m:g}"
        )
    if bottom.unknown_m > 0.0:
        problems.append(f"the bathymetry does not reach {bottom.unknown_m:.1f} m of the path")
    return bottom, problems


def _place(of: BottomCheck) -> str:
    return f"at {of.way_m:.0f} m of the path (north {of.north_m:.0f} m, east {of.east_m:.0f} m)"


def _corridor(zones: Zones, points: Array, way: Array) -> Array:
    """Return the free width (P,) in m across the path at every point; infinite where a side is open."""
    if len(points) < 2:
        return np.full(len(points), math.inf)
    along = np.gradient(points, way, axis=0)
    along /= np.maximum(np.hypot(*along.T), 1e-9)[:, None]
    starboard = np.column_stack([-along[:, 1], along[:, 0]])
    return _free(zones, points, starboard) + _free(zones, points, -starboard)


def _free(zones: Zones, points: Array, direction: Array) -> Array:
    """Return the distance (P,) in m from the points to a zone in their directions; infinite beyond ``WIDE_M``."""
    distance = np.zeros(len(points))
    for _ in range(200):  # sphere tracing: each step is as long as the distance to the nearest zone
        gap = clearances(zones, points + distance[:, None] * direction).min(axis=1)
        going = (gap > 0.01) & (distance < WIDE_M)
        if not going.any():
            break
        distance[going] += gap[going]
    return np.where(distance < WIDE_M, distance, math.inf)
