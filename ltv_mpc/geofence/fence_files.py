"""Fences of other programs: QGroundControl plans, and fence items of ArduPilot (MAV_CMD), also in a QGC WPL 110 file.

As MAVLink has it, the vehicle is inside all inclusion zones of a group, of any group. The zones of a plan, which knows
no groups, and those of group 0, in which programs without groups write all, are a group each: QGroundControl sends the
former as the latter. An inclusion circle becomes the polygon in it. The files have no margins: all are ``MARGIN_M``.
A list of positions alone, as ArduPilot's ground stations wrote it, is a return point and a closed inclusion polygon.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Literal

import msgspec
import pymap3d
import shapely

from ltv_mpc import config
from ltv_mpc.errors import ConfigError, naming
from ltv_mpc.geofence.geojson import Ring, zones_around
from ltv_mpc.messages import Pair
from ltv_mpc.references.geodesy import DEGREES, Origin
from ltv_mpc.references.mission_files import QGC_WPL, note_unused, read_plan, read_waypoints
from ltv_mpc.references.mission_items import WAYPOINT, Item, command_name

MARGIN_M, MAX_RADIUS_M = 1.0, 100_000.0
CORNERS = 32
"""Vertices of the polygon in an inclusion circle."""
RETURN_POINT, KEEP_IN, KEEP_OUT, CIRCLE_IN, CIRCLE_OUT = 5000, 5001, 5002, 5003, 5004  # MAV_CMD_NAV_FENCE


def read(path: Path, source: str, notes: list[str], origin: Origin | None) -> dict[str, Any] | None:
    """Return the table of a fence, as ``fence.toml`` holds it; None for a file that is none of another program.

    Parameters
    ----------
    path : the file; its suffix names the kind, in small or capital letters.
    source : name of the file in errors.
    notes : receives a sentence about the margins.
    origin : that of the reference, for a list without home.

    Raises
    ------
    ConfigError
        If the file cannot be read or is not a fence.
    """
    text, kind = config.read_text(path, what="fence"), path.suffix.lower()
    positions = _positions(text)
    if kind not in (".plan", ".waypoints") and not text.startswith(QGC_WPL) and not positions:
        return None
    if kind == ".plan":
        plan = read_plan(text, source)
        origin = plan.home() or origin
        items = _items_of(config.parse(plan.geo_fence or {}, _PlanFence, source=f"{source}: geoFence"))
        mission, rally = len(plan.mission.items), plan.count("rally_points", "points")
        note_unused(source, notes, items_of_its_mission=mission, rally_points=rally)
    else:
        home, *items = _ring_items(positions, source) if positions else read_waypoints(text, source)
        if home.command in (0, WAYPOINT):  # 0: Mission Planner's
            origin = Origin(latitude_deg=home.latitude_deg, longitude_deg=home.longitude_deg)
        else:
            items.insert(0, home)
    if origin is None:
        raise ConfigError(source, "", "has no home: give it one, or the reference an [origin]")
    notes.append(f"{source}: has no margins, each zone has {MARGIN_M:g} m")
    return {"margin_m": MARGIN_M, "origin": msgspec.to_builtins(origin), **zones_of(items, source)}


def _positions(text: str) -> list[tuple[float, float]]:
    """Return latitude and longitude (degrees) of each line of a list of positions; none if it is something else."""
    rows = [line.split() for line in text.splitlines() if line.strip() and not line.startswith("#")]
    with contextlib.suppress(msgspec.ValidationError):
        return msgspec.convert(rows, list[Pair], strict=False)
    return []


def _ring_items(positions: list[tuple[float, float]], source: str) -> list[Item]:
    """Return the inclusion polygon behind a return point as fence items."""
    ring = positions[1:-1]
    if len(ring) < 3 or positions[1] != positions[-1]:
        raise ConfigError(source, "", "must be a return point and a closed ring of at least 3 vertices")
    return [_item(k, KEEP_IN, len(ring), place) for k, place in enumerate(ring, start=1)]


class _Polygon(msgspec.Struct, frozen=True):
    """Polygon of the fence of a plan: latitude and longitude (degrees)."""

    polygon: tuple[Pair, ...]
    inclusion: bool
    version: Literal[1] = 1


class _CircleShape(msgspec.Struct, frozen=True):
    """Centre: latitude and longitude (degrees), and radius (m)."""

    center: Pair
    radius: float


class _Circle(msgspec.Struct, frozen=True):
    """Circle of the fence of a plan."""

    circle: _CircleShape
    inclusion: bool
    version: Literal[1] = 1


class _PlanFence(msgspec.Struct, frozen=True):
    """Fence of a plan."""

    polygons: tuple[_Polygon, ...] = ()
    circles: tuple[_Circle, ...] = ()
    version: Literal[2] = 2


def _items_of(fence: _PlanFence) -> list[Item]:
    """Return the fence of a plan as fence items, as QGroundControl sends it."""
    items = []
    for k, polygon in enumerate(fence.polygons):
        ring, command = polygon.polygon, KEEP_IN if polygon.inclusion else KEEP_OUT
        items += [_item(k, command, len(ring), place) for place in ring]
    for k, of in enumerate(fence.circles, start=len(fence.polygons)):
        command = CIRCLE_IN if of.inclusion else CIRCLE_OUT
        items.append(_item(k, command, of.circle.radius, of.circle.center))
    return items


def _item(number: int, command: int, first: float, place: Sequence[float]) -> Item:
    return Item(number, command, 0, (first, 0.0, 0.0, 0.0), place[0], place[1], 0.0)


def zones_of(items: Iterable[Item], source: str) -> dict[str, Any]:
    """Return the tables of keep-in and keep-out zones of fence items; none for a return point alone.

    Parameters
    ----------
    items : without home.
    source : name of the list in errors.

    Raises
    ------
    ConfigError
        If an item is no part of a fence, or a polygon is not complete.
    """
    table: dict[str, Any] = {}
    groups: dict[tuple[int, int], list[Any]] = {}
    ring: list[Item] = []
    for item in items:
        (size, group), command = item.parameters[:2], item.command
        where = f"item {item.number} {command_name(command)} ({command})"
        if ring and command != ring[0].command:
            problem = f"the polygon before it has {len(ring)} of {ring[0].parameters[0]:g} vertices"
            raise ConfigError(source, where, problem)
        places = [_place(item)]
        config.parse(places[0], Origin, source=f"{source}: {where}")
        if command in (CIRCLE_IN, CIRCLE_OUT):
            if not 0.0 < size <= MAX_RADIUS_M:
                raise ConfigError(source, f"{where} radius", f"must be above 0 and <= {MAX_RADIUS_M:g} m", value=size)
        elif command in (KEEP_IN, KEEP_OUT):
            ring.append(item)
            if len(ring) != size:
                continue
            places, ring = [_place(one) for one in ring], []
        elif command != RETURN_POINT:  # of a plane's fence: the vehicle keeps inside the zones instead
            raise ConfigError(source, where, "is no part of a fence")
        if command in (KEEP_IN, CIRCLE_IN):
            if not math.isfinite(group):
                raise ConfigError(source, f"{where} group", "must be a number, and finite", value=group)
            corners = places if command == KEEP_IN else _corners(places[0], size)
            with naming(source, where, "is no polygon: "):  # fewer than 3
                polygon = shapely.Polygon([(at["longitude_deg"], at["latitude_deg"]) for at in corners])
            groups.setdefault((int(group), 0 if group else len(groups)), []).append(polygon)
        elif command == KEEP_OUT:
            table.setdefault("keep_out", []).append({"vertices": places})
        elif command == CIRCLE_OUT:
            table.setdefault("keep_out_disc", []).append({"centre": places[0], "radius_m": size})
    if ring:
        raise ConfigError(source, "", f"the last polygon has {len(ring)} of {ring[0].parameters[0]:g} vertices")
    if groups:
        for name, rings in zones_around([*groups.values()], "inclusion zones", source).items():
            table.setdefault(name, []).extend({"vertices": one} for one in rings)
    return table


def _place(item: Item) -> dict[str, float]:
    return {"latitude_deg": item.latitude_deg, "longitude_deg": item.longitude_deg}


def _corners(centre: dict[str, float], radius_m: float) -> Ring:
    """Return the corners of the polygon in a circle."""
    offsets = shapely.get_coordinates(shapely.Point(0.0, 0.0).buffer(radius_m, quad_segs=CORNERS // 4))
    latitudes, longitudes, _ = pymap3d.ned2geodetic(*offsets.T, 0.0, *(centre[name] for name in DEGREES), 0.0)
    places = zip(latitudes.tolist(), longitudes.tolist(), strict=True)
    return [dict(zip(DEGREES, place, strict=True)) for place in places]
