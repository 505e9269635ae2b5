"""Check of a mission before it begins: a reference, a fence and a current, for one vehicle, with numbers."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial

import msgspec
import numpy as np

from ltv_mpc.bathymetry import Bathymetry
from ltv_mpc.control.config import MotionLimits
from ltv_mpc.geofence.fence import Fence, compare_origins, hull_radius_m
from ltv_mpc.messages import Array, Estimate, Pair
from ltv_mpc.references import Hold, Point, Reference
from ltv_mpc.references.limits import path_limits
from ltv_mpc.references.schedule import EAST, NORTH, WAY, Schedule
from ltv_mpc.vehicle.parameters import Vehicle
from ltv_mpc.vehicle.performance import Performance, performance, sideways_drag_N, stopping
from services.reporting.plots.fence import boundary
from services.runtime.console import figure
from services.tools.fence_check import ZoneCheck, check_fence, distance, sample


class BottomCheck(msgspec.Struct, frozen=True, kw_only=True):
    """Altitude of the reference above the bottom of a bathymetry, where it is least."""

    altitude_m: float  # negative: below the bottom
    depth_m: float  # of the reference
    way_m: float  # distance along the path
    north_m: float
    east_m: float
    too_deep_m: float  # length of the path on which the altitude is less than min_altitude_m
    unknown_m: float  # length of the path on which the bottom is not known

    @property
    def place(self) -> str:
        """Place where the altitude is least, as text."""
        return f"at {self.way_m:.0f} m of the path (north {self.north_m:.0f} m, east {self.east_m:.0f} m)"


def check_bottom(
    bathymetry: Bathymetry, schedule: Schedule, min_altitude_m: float
) -> tuple[BottomCheck | None, list[str]]:
    """Return where the altitude of a reference is least, and what is wrong with it.

    Parameters
    ----------
    bathymetry : soundings of the bottom.
    schedule : motion of the target, or a point as a schedule of one place.
    min_altitude_m : altitude that is kept (m).

    Returns
    -------
    None if the reference has no depth, or the bottom is not known below it; and the problems.
    """
    path = sample(schedule.table)
    if np.isnan(path.depth).all():
        return None, []
    altitude = bathymetry.depths(path.points) - path.depth
    if np.isnan(altitude).all():
        return None, ["the bathymetry does not reach the reference"]
    k = int(np.nanargmin(altitude))
    bottom = BottomCheck(
        altitude_m=float(altitude[k]),
        depth_m=float(path.depth[k]),
        way_m=float(path.way[k]),
        north_m=float(path.points[k, 0]),
        east_m=float(path.points[k, 1]),
        too_deep_m=path.length_where(altitude < min_altitude_m),
        unknown_m=path.length_where(np.isnan(altitude)),
    )
    problems = []
    if bottom.altitude_m < min_altitude_m:
        problems.append(
            f"the reference is too deep for {bottom.too_deep_m:.1f} m of the path, by up to "
            f"{min_altitude_m - bottom.altitude_m:.1f} m {bottom.place}: depth {bottom.depth_m:.1f} m, bottom "
            f"{bottom.depth_m + bottom.altitude_m:.1f} m, min_altitude_m = {min_altitude_m:g}"
        )
    if bottom.unknown_m > 0.0:
        problems.append(f"the bathymetry does not reach {bottom.unknown_m:.1f} m of the path")
    return bottom, problems


LABEL_WIDTH = 38
"""Least width of the first column of the table."""

COLUMNS, ROWS = 72, 24
ASPECT = 2.0
"""Height of a letter over its width."""

_metres = partial(figure, unit="m", digits=".3g", none="none")


class MissionCheck(msgspec.Struct, frozen=True, kw_only=True):
    """Result of the check of a mission."""

    length_m: float
    duration_s: float  # with the ways round zones
    largest_depth_m: float | None  # that the reference asks for
    current_mps: float
    drift_m: float | None  # while the vehicle turns into the current by 90 degrees; null: it cannot turn
    stopping_m: float | None  # from the speed of the reference, with the drift meanwhile; null: it does not stop
    corridor_m: float | None  # narrowest free width along the allowed path; null: open
    needed_m: float | None  # width that the vehicle needs: hull, two margins and the drift
    bottom: BottomCheck | None  # null: without a bathymetry, or the bottom is not known below the reference
    zones: list[ZoneCheck]
    problems: list[str]  # what cannot be
    notes: list[str]  # what the controller does otherwise than the reference says


def check_mission(
    vehicle: Vehicle,
    reference: Reference,
    fence: Fence | None,
    *,
    start: Pair | None = None,
    current_mps: float = 0.0,
    bottom: float | Bathymetry | None = None,
    limits: MotionLimits | None = None,
) -> MissionCheck:
    """Check a reference against a fence, a current and the depths.

    Parameters
    ----------
    vehicle : its file needs [hull] if there is a fence.
    reference : path or point; "here" needs the start for the fence and the soundings.
    fence : its origin is that of the reference; None: only current and depths are checked.
    start : north and east of the vehicle (m); None: it begins at the first point of the path.
    current_mps : speed of the water, from any direction.
    bottom : its depth (m) or soundings of it; None: not known.
    limits : limits of the controller's settings: depths and cross-track distance.

    Raises
    ------
    ConfigError : the vehicle has no hull, or the origins differ.
    """
    compare_origins(fence, reference)
    schedule, depth, speed_mps = _schedule(vehicle, reference, start)
    largest = None if np.isnan(depth).all() else float(np.nanmax(depth))
    can = performance(vehicle)
    drift_m = None if can.turn_90deg_s is None else current_mps * can.turn_90deg_s
    stop = stopping(vehicle, speed_mps) if speed_mps > 0.0 else (0.0, 0.0)
    stopping_m = None if stop is None else stop[0] + current_mps * stop[1]
    limits = limits or MotionLimits()
    problems = [
        *_current_problems(vehicle, current_mps),
        *_heading_problems(vehicle, reference, current_mps, can),
        *_corridor_problems(reference, limits.max_cross_track_m, drift_m, current_mps),
        *_depth_problems(largest, bottom if isinstance(bottom, float) else None, limits),
    ]
    lowest = None
    if schedule is None:
        why = "is not checked: the reference begins where the vehicle is; give this position with --start NORTH,EAST"
        unchecked = {"--fence": fence is not None, "--bottom": isinstance(bottom, Bathymetry)}
        problems += [f"{option} {why}" for option, is_given in unchecked.items() if is_given]
    elif isinstance(bottom, Bathymetry):
        lowest, too_deep = check_bottom(bottom, schedule, limits.min_altitude_m or 0.0)
        problems += too_deep
    zones, corridor_m, needed_m, notes = [], None, None, reference.notes(vehicle)
    duration_s = 0.0 if schedule is None else schedule.duration_s
    if fence is not None and schedule is not None:
        hull_m = hull_radius_m(vehicle)
        found = check_fence(fence, hull_m, schedule, start)
        zones, duration_s = found.zones, found.duration_s
        notes += found.notes
        problems += [*found.problems, *_margin_problems(zones, stopping_m, speed_mps)]
        corridor_m = None if found.narrowest is None else found.narrowest[0]
        if drift_m is not None:
            needed_m = 2.0 * hull_m + 2.0 * max(zone.margin_m for zone in zones) + drift_m
            problems += _width_problems(found.narrowest, needed_m, drift_m, current_mps)
    return MissionCheck(
        length_m=0.0 if schedule is None else float(schedule.table[WAY, -1]),
        duration_s=duration_s,
        largest_depth_m=largest,
        current_mps=current_mps,
        drift_m=drift_m,
        stopping_m=stopping_m,
        corridor_m=corridor_m,
        needed_m=needed_m,
        bottom=lowest,
        zones=zones,
        problems=problems,
        notes=notes,
    )


def picture(vehicle: Vehicle, reference: Reference, fence: Fence | None, start: Pair | None = None) -> str:
    """Return a map of the reference and the fence as text, north up: what the files were read as.

    B begin, E end, * path, + keep-in, # keep-out; empty if there is nothing to draw.
    """
    import shapely  # takes a tenth of a second

    schedule = _schedule(vehicle, reference, start)[0]
    lines = [("+" if zone.keep_in else "#", boundary(zone)) for zone in (fence.zones() if fence else ())]
    if schedule is not None:
        way = schedule.table[[NORTH, EAST]].T
        lines += [("*", way), ("B", way[:1]), ("E", way[-1:])]
    if not lines:
        return ""
    places = np.concatenate([line for _, line in lines])
    low, extent = places.min(axis=0), np.ptp(places, axis=0)
    column_m = max(extent[1] / (COLUMNS - 1), extent[0] / (ROWS - 1) / ASPECT, 0.01)
    rows = int(extent[0] / column_m / ASPECT) + 1
    letters = np.full((rows, int(extent[1] / column_m) + 1), " ")
    for letter, line in lines:
        if np.ptp(line, axis=0).any():  # one place is no line
            line = shapely.get_coordinates(shapely.segmentize(shapely.LineString(line), 0.5 * column_m))
        cells = np.rint((line - low) / (column_m * ASPECT, column_m)).astype(np.int64)
        row, column = np.minimum(cells, np.array(letters.shape) - 1).T
        letters[rows - 1 - row, column] = letter
    keys = {"*": "B to E path", "+": "+ keep-in", "#": "# keep-out"}
    legend = [key for letter, key in keys.items() if letter in {letter for letter, _ in lines}]
    scale = f"north up, {extent[1]:.3g} m east by {extent[0]:.3g} m north, a letter is {column_m:.2g} m wide"
    return "\n".join([*("  " + "".join(row).rstrip() for row in letters), f"  {', '.join([*legend, scale])}"])


def table(of: MissionCheck) -> str:
    """Format the result as text."""
    depth = "" if of.largest_depth_m is None else f", down to {of.largest_depth_m:g} m"
    lines = [f"mission: {of.length_m:.0f} m in {of.duration_s:.0f} s{depth}, current {of.current_mps:.3g} m/s"]
    rows = [
        ("drift while turning into the current", _metres(of.drift_m)),
        ("stopping distance with drift", _metres(of.stopping_m)),
    ]
    if of.zones and of.length_m > 0.0:
        rows.append(("narrowest corridor", _metres(of.corridor_m, none="open")))
        rows.append(("width that the vehicle needs", _metres(of.needed_m)))
    if of.bottom is not None:
        rows.append(("altitude of the reference", f"{of.bottom.altitude_m:.3g} m or more, {of.bottom.place}"))
    for zone in of.zones:
        at = f" at {zone.way_m:.0f} m of the path" if of.length_m > 0.0 else ""
        where = f"{distance(zone.clearance_m)}{at}, margin {zone.margin_m:g} m"
        rows.append((f"hull from {zone.zone}", where))
    width = max(LABEL_WIDTH, *(len(name) + 2 for name, _ in rows))
    lines += [f"  {name:<{width}}{value}" for name, value in rows]
    lines += [f"  note: {note}" for note in of.notes]
    lines += [f"  problem: {problem}" for problem in of.problems] or ["  no problems"]
    return "\n".join(lines)


def _schedule(vehicle: Vehicle, reference: Reference, start: Pair | None) -> tuple[Schedule | None, Array, float]:
    """Return the schedule, a point's with one place and None for an unknown one, depths (m) and largest speed (m/s)."""
    if isinstance(reference, Hold) and start is None:
        return None, np.array([math.nan if reference.depth_m is None else reference.depth_m]), 0.0
    north_m, east_m = start or (0.0, 0.0)
    anchor = reference.anchor(Estimate.at_rest(north_m=north_m, east_m=east_m))
    if isinstance(reference, Point | Hold):
        schedule = reference.schedule(vehicle, anchor)._replace(lead_m=0.0)
    else:
        schedule = reference.schedule(vehicle, None if start is None else anchor)
    t, s, *_, depth = schedule.table
    moving = np.diff(t) > 0.0
    speed_mps = float((np.diff(s)[moving] / np.diff(t)[moving]).max(initial=0.0))
    return schedule, depth, min(speed_mps, path_limits(vehicle).top_mps)


def _width_problems(narrowest: Pair | None, needed_m: float, drift_m: float, current_mps: float) -> Iterator[str]:
    """Yield where the allowed path is narrower than the width that the vehicle needs."""
    if narrowest is not None and narrowest[0] < needed_m:
        width_m, way_m = narrowest
        yield (
            f"the corridor is {width_m:.1f} m wide at {way_m:.0f} m of the path: the vehicle needs {needed_m:.1f} m, "
            f"hull and two margins and {drift_m:.1f} m of drift while it turns into {current_mps:.3g} m/s"
        )


def _margin_problems(zones: list[ZoneCheck], stopping_m: float | None, speed_mps: float) -> Iterator[str]:
    """Yield the margins that are shorter than the stopping distance, of zones that the path comes that near to."""
    if stopping_m is None:
        yield f"the vehicle does not stop from {speed_mps:.2f} m/s, so no margin is long enough"
        return
    takes = f"stopping from {speed_mps:.2f} m/s takes {stopping_m:.1f} m"
    for zone in zones:
        if stopping_m > zone.margin_m and zone.clearance_m < stopping_m:
            yield f"{zone.zone}: {takes}, margin {zone.margin_m:g} m"


def _current_problems(vehicle: Vehicle, current_mps: float) -> Iterator[str]:
    """Yield why the vehicle cannot stay in the current, or can do so only without a reserve of thrust."""
    limits, current = path_limits(vehicle), f"a current of {current_mps:.3g} m/s"
    if current_mps >= limits.top_mps:
        yield f"{current} carries the vehicle away: full thrust holds {limits.top_mps:.2f} m/s"
    elif current_mps >= limits.cruise_mps:
        left = f"full thrust makes {limits.top_mps - current_mps:.2g} m/s against it"
        yield (
            f"{current} takes more than 80 % of the thrust, which hold {limits.cruise_mps:.2f} m/s: {left}, without a "
            "reserve for waves and steering"
        )


def _heading_problems(vehicle: Vehicle, reference: Reference, current_mps: float, can: Performance) -> Iterator[str]:
    """Yield at which angles to the current the vehicle holds a fixed heading, and what pushes it at others."""
    if not isinstance(reference, Point | Hold) or reference.heading_deg is None or current_mps == 0.0:
        return
    astern_mps = can.top_speed_astern_mps
    stern = astern_mps is None or current_mps <= astern_mps
    ends = "bow or stern into the current (0 or 180 degrees)" if stern else "the bow into the current (0 degrees)"
    oblique_N, across_N = (sideways_drag_N(vehicle, current_mps, angle_deg) for angle_deg in (45.0, 90.0))
    yield (
        f"heading_deg = {reference.heading_deg:g} is held in a current of {current_mps:.3g} m/s only with {ends}: at "
        f"45 degrees the water pushes sideways with {oblique_N:.1f} N, at 90 degrees with {across_N:.1f} N, and the "
        "vehicle has no side thrust, so the bow turns and swings to hold the position"
    )


def _corridor_problems(
    reference: Reference, half_width_m: float | None, drift_m: float | None, current_mps: float
) -> Iterator[str]:
    """Yield why the vehicle cannot keep to its largest cross-track distance."""
    if half_width_m is None or isinstance(reference, Point | Hold):
        return
    kept = f"max_cross_track_m = {half_width_m:g} is not kept: the vehicle"
    if drift_m is None:
        yield f"{kept} cannot turn into a current"
    elif drift_m > half_width_m:
        yield f"{kept} drifts {drift_m:.2f} m while it turns into {current_mps:.3g} m/s"


def _depth_problems(largest: float | None, bottom_m: float | None, limits: MotionLimits) -> Iterator[str]:
    """Yield what is wrong with the depths of the reference."""
    if largest is None:
        return
    altitude_m = limits.min_altitude_m or 0.0
    if bottom_m is not None and largest > bottom_m - altitude_m:
        ends = "no min_altitude_m stops the vehicle"
        if altitude_m:
            ends = f"with min_altitude_m = {altitude_m:g} the vehicle stops at {bottom_m - altitude_m:g} m"
        yield f"the reference descends to {largest:g} m, the bottom is at {bottom_m:g} m: {ends}"
    if limits.max_depth_m is not None and largest > limits.max_depth_m:
        yield f"the reference descends to {largest:g} m: max_depth_m = {limits.max_depth_m:g}"
