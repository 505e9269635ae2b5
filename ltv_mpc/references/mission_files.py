"""Paths in files of other programs: QGroundControl plans, ArduPilot waypoints, GPX, GeoJSON.

The items of a mission are those of an autopilot (``mission_items.py``): an error names those that cannot be driven.
Altitudes above home are depths if any is negative; other altitudes are not used. A file without a speed asks for the
largest one, which ``notes`` reduce to that of the vehicle. The origin is the home of the file, else its first position.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from msgspec import Meta, Struct, ValidationError, convert

from ltv_mpc import config
from ltv_mpc.errors import ConfigError, naming
from ltv_mpc.references.geodesy import Origin
from ltv_mpc.references.mission_items import (
    LAST,
    MAX_SPEED_MPS,
    PLACES,
    RELATIVE,
    WAYPOINT,
    Item,
    ItemRefused,
    Stop,
    reference_table,
    refusals,
    stops_of,
)
from ltv_mpc.references.shapes import Waypoint

MOST_REFUSALS = 10
"""Number of refused items that an error names."""
_ITEM = tuple[int, int, int, int, float, float, float, float, float, float, float, float]
"""Line of QGC WPL 110: number, is current, frame, command, 4 parameters, latitude, longitude, altitude, continues."""
QGC_WPL = "QGC WPL "
"""Begin of a list of items, which programs write with several suffixes."""


class _PlanItem(Struct, frozen=True, rename="camel"):
    """Item of the mission of a QGroundControl plan."""

    type: str
    do_jump_id: int
    complex_item_type: str = ""
    command: int = 0
    frame: int = 0
    params: tuple[float | None, ...] = ()


class _Mission(Struct, frozen=True, rename="camel"):
    """Mission of a QGroundControl plan."""

    items: list[dict[str, Any]]
    planned_home_position: Annotated[tuple[float | None, ...], Meta(min_length=2)] | None = None
    cruise_speed: float = MAX_SPEED_MPS
    version: Literal[2] = 2


class Plan(Struct, frozen=True, rename="camel"):
    """QGroundControl plan."""

    mission: _Mission
    geo_fence: dict[str, Any] | None = None
    rally_points: dict[str, Any] | None = None
    file_type: Literal["Plan"] = "Plan"
    version: Literal[1] = 1

    def home(self) -> Origin | None:
        """Return the planned home position, if the plan has one."""
        latitude, longitude = (self.mission.planned_home_position or (None, None))[:2]
        return None if latitude is None or longitude is None else _origin(latitude, longitude)

    def count(self, of: str, name: str) -> int:
        """Return the number of entries of a list that is not read.

        Parameters
        ----------
        of : member of the plan.
        name : member of that.
        """
        found = (getattr(self, of) or {}).get(name)
        return len(found) if isinstance(found, list) else 0


def read(path: Path, source: str, notes: list[str]) -> dict[str, Any] | None:
    """Return the table of a reference, as a TOML file holds it; None for a file that is none of another program.

    Parameters
    ----------
    path : the file; its suffix names the kind, in small or capital letters, but for QGC WPL that of its first line.
    source : name of the file in errors.
    notes : receives a sentence about what the file holds beside the path.

    Raises
    ------
    ConfigError
        If the file cannot be read, or holds what cannot be followed.
    """
    text = config.read_text(path, what="reference")
    reader = READERS.get(".waypoints" if text.startswith(QGC_WPL) else path.suffix.lower())
    if reader is None:
        return None
    home, stops = reader(text, source, notes)
    if not stops:
        raise ConfigError(source, "", "has no path and no point")
    with naming(source):
        table = reference_table(stops, home or _origin(stops[0].place.latitude_deg, stops[0].place.longitude_deg))
    if table["kind"] == "point" and len(stops) > 1:
        notes.append(f"{source}: its {len(stops)} positions are one place, a point at which the vehicle stays")
    return table


Content = tuple[Origin | None, list[Stop]]
"""Home, if the file has it, and waypoints."""


def _origin(latitude_deg: Any, longitude_deg: Any) -> Origin:
    return Origin(latitude_deg=float(latitude_deg), longitude_deg=float(longitude_deg))


def _path(positions: Iterable[tuple[float, float]], speed_mps: float | None = None) -> list[Stop]:
    """Return positions (latitude and longitude, degrees) as waypoints."""
    speed = MAX_SPEED_MPS if speed_mps is None else speed_mps
    return [Stop(0, Waypoint(latitude_deg=at, longitude_deg=on), speed) for at, on in positions]


def note_unused(source: str, notes: list[str], **numbers: int) -> None:
    """Add a note about what a file holds and is not used.

    Parameters
    ----------
    source : name of the file.
    notes : receives the note, if there is any such thing.
    numbers : how many there are of each, by their name.
    """
    if found := [f"{number} {name.replace('_', ' ')}" for name, number in numbers.items() if number]:
        notes.append(f"{source}: not used are {', '.join(found)}")


def _mission(items: Sequence[Item], speed_mps: float, source: str, notes: list[str], **beside: int) -> Content:
    """Return home, which is the first of the items if it has a place, and the waypoints.

    The mission is that of a vehicle that dives if it goes down. ``beside`` are numbers of what else the file holds.
    """
    first = next((item for item in items if item.has_place), items[0])
    home = _origin(first.latitude_deg, first.longitude_deg)
    places = [item for item in items[1:] if item.command in PLACES]
    dives = any(item.frame in RELATIVE and item.altitude_m < 0.0 for item in places)
    note_unused(source, notes, **beside, altitudes=0 if dives else sum(item.altitude_m != 0.0 for item in places))
    refused = refusals(items, dives=dives)
    endless = next((k for k, item in enumerate(items) if item.command in LAST), len(items))
    refused += [ItemRefused(item, "follows an item without an end") for item in items[endless + 1 :]]
    with naming(source, problem="cannot be followed: "):
        if refused:
            raise ValueError("; ".join(map(str, refused[:MOST_REFUSALS])))
        return home, stops_of(items, home, speed_mps, None, dives=dives)


def read_waypoints(text: str, source: str) -> list[Item]:
    """Return the items of a QGC WPL 110 file; the first one is home.

    Parameters
    ----------
    text : content of the file.
    source : name of the file in errors.
    """
    first, *lines = text.splitlines()
    if first.split() != ["QGC", "WPL", "110"]:
        raise ConfigError(source, "line 1", 'must be "QGC WPL 110"', value=first[:40])
    items = []
    for k, line in enumerate(lines, start=2):
        try:
            if cells := line.partition("#")[0].split():
                number, _, frame, command, *rest = convert(cells, _ITEM, strict=False)
                items.append(Item(number, command, frame, tuple(rest[:4]), *rest[4:7]))
        except ValidationError:
            raise ConfigError(source, f"line {k}", "must have 12 numbers, the first 4 whole", value=line[:60]) from None
    if not items:
        raise ConfigError(source, "", "has no items")
    check_numbers(items, source)
    return items


def check_numbers(items: Sequence[Item], source: str) -> None:
    """Raise ``ConfigError`` if two items have one number: errors and jumps name items by it.

    Parameters
    ----------
    items : of a mission or a fence.
    source : name of the file in errors.
    """
    ((number, count),) = Counter(item.number for item in items).most_common(1)
    if count > 1:
        raise ConfigError(source, f"item {number}", f"has its number {count} times: give each item one of its own")


def _waypoints(text: str, source: str, notes: list[str]) -> Content:
    return _mission(read_waypoints(text, source), MAX_SPEED_MPS, source, notes)


def read_plan(text: str, source: str) -> Plan:
    """Return a QGroundControl plan. Raises ``ConfigError``.

    Parameters
    ----------
    text : content of the file.
    source : name of the file in errors.
    """
    return config.parse(config.parse_json(text, source), Plan, source=source)


def _plan(text: str, source: str, notes: list[str]) -> Content:
    """Read a QGroundControl plan."""
    plan = read_plan(text, source)
    home = plan.home() or Origin(latitude_deg=0.0, longitude_deg=0.0)  # a place of 0, 0 is none
    items = [Item(0, WAYPOINT, 0, (0.0,) * 4, home.latitude_deg, home.longitude_deg, 0.0)]
    for k, table in enumerate(plan.mission.items, start=1):
        number = table.get("doJumpId", k)
        entry = config.parse({"doJumpId": k} | table, _PlanItem, source=f"{source}: item {number}")
        if entry.type != "SimpleItem":
            name = entry.complex_item_type or entry.type
            raise ConfigError(source, f"item {number}", f"{name} cannot be followed: give its waypoints")
        parameters = tuple(number or 0.0 for number in entry.params)
        if len(parameters) != 7:
            raise ConfigError(source, f"item {number}", f"has {len(parameters)} of 7 parameters")
        items.append(Item(entry.do_jump_id, entry.command, entry.frame, parameters[:4], *parameters[4:]))
    check_numbers(items, source)
    zones = plan.count("geo_fence", "polygons") + plan.count("geo_fence", "circles")
    points = plan.count("rally_points", "points")
    cruise_mps = plan.mission.cruise_speed
    return _mission(items, cruise_mps, source, notes, zones_of_its_geofence=zones, rally_points=points)


def _gpx(text: str, source: str, notes: list[str]) -> Content:
    """Read the only route or track of a GPX file."""
    try:
        import gpxpy
    except ImportError:
        raise ConfigError(source, "", 'is GPX: install the extra "gpx", gpxpy') from None
    with naming(source, "", "is not valid GPX: ", gpxpy.gpx.GPXException):
        gpx = gpxpy.parse(text.partition("?>")[2] if text.startswith("<?xml") else text)  # it is no more as declared
    found = [list(of.walk(only_points=True)) for of in list[Any]((*gpx.routes, *gpx.tracks))]
    paths = list(filter(None, found))
    empty, beside = len(found) - len(paths), len(gpx.waypoints) if paths else 0
    paths = paths or [[point] for point in gpx.waypoints]
    if len(paths) != 1:
        has = f"{len(gpx.routes)} routes, {len(gpx.tracks)} tracks, {len(gpx.waypoints)} waypoints, which have no order"
        raise ConfigError(source, "", f"must have one route or track, it has {has}")
    heights, times = (sum(getattr(point, of) is not None for point in paths[0]) for of in ("elevation", "time"))
    note_unused(
        source, notes, empty_routes_and_tracks=empty, waypoints_beside_it=beside, elevations=heights, times=times
    )
    return None, _path((point.latitude, point.longitude) for point in paths[0])


def _geojson(text: str, source: str, notes: list[str]) -> Content:
    """Read the only LineString, or else the only Point, of the features that are no zones of a fence."""
    from ltv_mpc.geofence.geojson import features_of, places_of

    content, features = features_of(text, source, notes)
    others = [feature for feature in features if not feature.is_reference]
    for feature in others:
        if "zone" not in feature.properties:
            raise ConfigError(source, feature.where, "must be a LineString, a Point, or a zone of a fence")
    own = [feature for feature in features if feature.is_reference]
    lines = [feature for feature in own if feature.shape.geom_type == "LineString"]
    paths = lines or own
    if len(paths) != 1:
        raise ConfigError(source, "features", f"must hold one LineString, or else one Point, they hold {len(paths)}")
    ((_, properties, shape),) = paths
    heights = len(places_of(shape)) if shape.has_z else 0
    note_unused(source, notes, zones_of_a_fence=len(others), points_beside_it=len(own) - 1, heights=heights)
    origin = content.get("origin")
    home = None if origin is None else config.parse(origin, Origin, source=f"{source}: origin")
    at = ((place["latitude_deg"], place["longitude_deg"]) for place in places_of(shape))
    return home, _path(at, properties.get("speed_mps"))


READERS = {".waypoints": _waypoints, ".plan": _plan, ".gpx": _gpx, ".geojson": _geojson, ".json": _geojson}
"""Reader of each kind of file, by its suffix."""
