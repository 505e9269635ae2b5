"""Fences of other programs: QGroundControl plans, and fence items of ArduPilot (MAV_CMD), also in a QGC WPL 110 file.

As MAVLink has it, the vehicle is inside all inclusion zones of a group, of any group. The zones of a plan, which knows
no groups, and those of group 0, in which programs without groups write all, are a group each: QGroundControl sends the
former as the latter. An inclusion circle becomes the polygon in it. The files have no margins: all are ``MARGIN_M``.
A list of positions alone, as ArduPilot's ground stations wrote it, is a return point and a closed inclusion polygon.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from ltv_mpc import config
from ltv_mpc.errors import ConfigError
from ltv_mpc.geofence.geojson import Ring, zones_around
from ltv_mpc.references.geodesy import Origin, degrees
from ltv_mpc.references.mission_files import QGC_WPL, note_unused, read_waypoints
from ltv_mpc.references.mission_items import WAYPOINT, Item, command_name

MARGIN_M, MAX_RADIUS_M = 1.0, 100_000.0
CORNERS = 32
"""Vertices of the polygon in an inclusion circle."""
RETURN_POINT, KEEP_IN, KEEP_OUT, CIRCLE_IN, CIRCLE_OUT = 5000, 5001, 5002, 5003, 5004  # MAV_CMD_NAV_FENCE


class Area(NamedTuple):
    """Polygon, or circle around its only position; positions are latitude and longitude (degrees)."""

    inside: bool  # the vehicle stays in it
    group: int
    positions: list[Sequence[float]]
    radius_m: float = 0.0

    @classmethod
    def circle(cls, inside: bool, group: int, centre: Sequence[float], radius_m: float, where: tuple[str, str]) -> Area:
        """Return a circle. Raises ``ConfigError`` if its radius is not that of one.

        Parameters
        ----------
        inside, group, radius_m : of the area.
        centre : latitude and longitude (degrees).
        where : names of file and field in errors.
        """
        if not 0.0 < radius_m <= MAX_RADIUS_M:
            raise ConfigError(*where, f"must be above 0 and <= {MAX_RADIUS_M:g} m", value=radius_m)
        return cls(inside, group, [centre], radius_m)


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
    try:
        if kind == ".plan":
            plan = config.parse_json(text, source)
            latitude, longitude = map(float, plan["mission"]["plannedHomePosition"][:2])
            origin = Origin(latitude_deg=latitude, longitude_deg=longitude)
            areas = _of_plan(plan, source)
            mission, rally = plan["mission"].get("items") or (), (plan.get("rallyPoints") or {}).get("points") or ()
            note_unused(source, notes, items_of_its_mission=len(mission), rally_points=len(rally))
        else:
            home, *items = _ring_items(positions, source) if positions else read_waypoints(text, source)
            if home.command in (0, WAYPOINT):  # 0: Mission Planner's
                origin = Origin(latitude_deg=home.latitude_deg, longitude_deg=home.longitude_deg)
            else:
                items.insert(0, home)
            if origin is None:
                raise ConfigError(source, "", "has no home: item 0, or the [origin] of a reference")
            areas = _of_items(items, source)
        notes.append(f"{source}: has no margins, each zone has {MARGIN_M:g} m")
        return {"margin_m": MARGIN_M, "origin": msgspec.to_builtins(origin), **_zones(areas, source)}
    except ConfigError:
        raise
    except (TypeError, KeyError, ValueError, IndexError, OverflowError) as error:
        raise ConfigError(source, "", f"is no fence: {error}") from None


def _positions(text: str) -> list[tuple[float, float]]:
    """Return latitude and longitude (degrees) of each line of a list of positions; none if it is something else."""
    rows = [line.split() for line in text.splitlines() if line.strip() and not line.startswith("#")]
    try:
        return [(float(row[0]), float(row[1])) for row in rows] if {len(row) for row in rows} == {2} else []
    except ValueError:
        return []


def _ring_items(positions: list[tuple[float, float]], source: str) -> list[Item]:
    """Return the inclusion polygon behind a return point as fence items."""
    ring = positions[1:-1]
    if len(ring) < 3 or positions[1] != positions[-1]:
        raise ConfigError(source, "", "must be a return point and a closed ring of at least 3 vertices")
    return [Item(k, KEEP_IN, 0, (len(ring), 0.0, 0.0, 0.0), *place, 0.0) for k, place in enumerate(ring, start=1)]


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
    return _zones(_of_items(items, source), source)


def _zones(areas: Iterable[Area], source: str) -> dict[str, Any]:
    """Return the tables of keep-in and keep-out zones."""
    table: dict[str, Any] = {}
    groups: dict[tuple[int, int], list[list[Ring]]] = {}
    for number, area in enumerate(areas):
        ring = [_place(position) for position in area.positions]
        if area.inside:
            group = (area.group, 0 if area.group else number)
            groups.setdefault(group, []).append([_polygon_in(area) if area.radius_m else ring])
        elif area.radius_m:
            table.setdefault("keep_out_disc", []).append({"centre": ring[0], "radius_m": area.radius_m})
        else:
            table.setdefault("keep_out", []).append({"vertices": ring})
    if groups:
        for name, rings in zones_around([*groups.values()], "inclusion zones", source).items():
            table.setdefault(name, []).extend({"vertices": ring} for ring in rings)
    return table


def _of_plan(plan: Any, source: str) -> Iterator[Area]:
    fence = plan["geoFence"]
    for polygon in fence["polygons"]:
        yield Area(bool(polygon["inclusion"]), 0, polygon["polygon"])
    for k, circle in enumerate(fence["circles"]):
        centre, radius_m = circle["circle"]["center"], float(circle["circle"]["radius"])
        yield Area.circle(bool(circle["inclusion"]), 0, centre, radius_m, (source, f"circles[{k}] radius"))


def _of_items(items: Iterable[Item], source: str) -> Iterator[Area]:
    ring: list[Item] = []
    for item in items:
        size, group = item.parameters[:2]
        if ring and item.command != ring[0].command:
            problem = f"the polygon before it has {len(ring)} of {ring[0].parameters[0]:g} vertices"
            raise ConfigError(source, f"item {item.number}", problem)
        if item.command in (KEEP_IN, KEEP_OUT):
            ring.append(item)
            if len(ring) == size:
                yield Area(item.command == KEEP_IN, int(group), [(one.latitude_deg, one.longitude_deg) for one in ring])
                ring = []
        elif item.command in (CIRCLE_IN, CIRCLE_OUT):
            centre, where = (item.latitude_deg, item.longitude_deg), (source, f"item {item.number} radius")
            yield Area.circle(item.command == CIRCLE_IN, int(group), centre, size, where)
        elif item.command != RETURN_POINT:  # of a plane's fence: the vehicle keeps inside the zones instead
            name = command_name(item.command)
            raise ConfigError(source, f"item {item.number} {name} ({item.command})", "is no part of a fence")
    if ring:
        raise ConfigError(source, "", f"the last polygon has {len(ring)} of {ring[0].parameters[0]:g} vertices")


def _place(position: Sequence[float]) -> dict[str, float]:
    return {"latitude_deg": float(position[0]), "longitude_deg": float(position[1])}


def _polygon_in(circle: Area) -> Ring:
    centre = Origin(latitude_deg=circle.positions[0][0], longitude_deg=circle.positions[0][1])
    angles = [2.0 * math.pi * k / CORNERS for k in range(CORNERS)]
    return [_place(degrees(circle.radius_m * math.cos(a), circle.radius_m * math.sin(a), centre)) for a in angles]
