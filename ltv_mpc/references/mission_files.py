"""Paths in files of other programs: QGroundControl plans, ArduPilot waypoints, GPX, GeoJSON.

The items of a mission are those of an autopilot (``mission_items.py``): an error names those that cannot be driven.
Altitudes above home are depths if any is negative; other altitudes are not used. A file without a speed asks for the
largest one, which ``notes`` reduce to that of the vehicle. The origin is the home of the file, else its first position.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from ltv_mpc import config
from ltv_mpc.errors import ConfigError
from ltv_mpc.references.geodesy import Origin
from ltv_mpc.references.mission_items import (
    LAST,
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

MAX_SPEED_MPS = 20.0
"""Largest speed of a reference."""
MOST_REFUSALS = 10
"""Number of refused items that an error names."""


def read(path: Path, source: str) -> dict[str, Any] | None:
    """Return the table of a reference, as a TOML file holds it; None for a file that is none of another program.

    Parameters
    ----------
    path : the file; its suffix names the kind, in small or capital letters.
    source : name of the file in errors.

    Raises
    ------
    ConfigError
        If the file cannot be read, or holds what cannot be followed.
    """
    kind = path.suffix.lower()
    if kind not in READERS:
        return None
    home, stops = READERS[kind](config.read_text(path, what="reference"), source)
    if not stops:
        raise ConfigError(source, "", "has no path and no point")
    try:
        return reference_table(stops, home or _origin(stops[0].place.latitude_deg, stops[0].place.longitude_deg))
    except ValueError as error:
        raise ConfigError(source, "", str(error)) from None


Content = tuple[Origin | None, list[Stop]]
"""Home, if the file has it, and waypoints."""


def _origin(latitude_deg: Any, longitude_deg: Any) -> Origin:
    return Origin(latitude_deg=float(latitude_deg), longitude_deg=float(longitude_deg))


def _path(positions: Iterable[tuple[float, float]], speed_mps: float | None = None) -> list[Stop]:
    """Return positions (latitude and longitude, degrees) as waypoints."""
    speed = MAX_SPEED_MPS if speed_mps is None else speed_mps
    return [Stop(0, Waypoint(latitude_deg=at, longitude_deg=on), speed) for at, on in positions]


def _mission(items: Sequence[Item], speed_mps: float, source: str) -> Content:
    """Return home, the first of the items, and the waypoints. It is that of a vehicle that dives if it goes down."""
    home = _origin(items[0].latitude_deg, items[0].longitude_deg)
    dives = any(item.command in PLACES and item.frame in RELATIVE and item.altitude_m < 0.0 for item in items[1:])
    refused = refusals(items, dives=dives)
    endless = next((k for k, item in enumerate(items) if item.command in LAST), len(items))
    refused += [ItemRefused(item, "follows an item without an end") for item in items[endless + 1 :]]
    try:
        stops = [] if refused else stops_of(items, home, speed_mps, None, dives=dives)
    except ItemRefused as error:
        refused = [error]
    if refused:
        raise ConfigError(source, "", f"cannot be followed: {'; '.join(map(str, refused[:MOST_REFUSALS]))}")
    return home, stops


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
            if cells := [float(cell) for cell in line.split()]:
                number, _, frame, command, *parameters, latitude, longitude, altitude, _ = cells
                if len(parameters) != 4:
                    raise ValueError
                place = latitude, longitude, altitude
                items.append(Item(int(number), int(command), int(frame), tuple(parameters), *place))
        except (ValueError, OverflowError):
            raise ConfigError(source, f"line {k}", "must have 12 numbers", value=line[:60]) from None
    if not items:
        raise ConfigError(source, "", "has no items")
    return items


def _waypoints(text: str, source: str) -> Content:
    return _mission(read_waypoints(text, source), MAX_SPEED_MPS, source)


def _plan(text: str, source: str) -> Content:
    """Read a QGroundControl plan."""
    mission = config.parse_json(text, source).get("mission")
    try:
        latitude, longitude = map(float, mission["plannedHomePosition"][:2])  # type: ignore[index]
        items = [Item(0, WAYPOINT, 0, (0.0,) * 4, latitude, longitude, 0.0)]
        for k, entry in enumerate(mission["items"], start=1):  # type: ignore[index]
            number = int(entry.get("doJumpId", k))
            if entry["type"] != "SimpleItem":
                name = entry.get("complexItemType", entry["type"])
                raise ConfigError(source, f"item {number}", f"{name} cannot be followed: give its waypoints")
            parameters = tuple(float(number or 0.0) for number in entry["params"])
            if len(parameters) != 7:
                raise ValueError(f"item {number} has {len(parameters)} of 7 parameters")
            items.append(Item(number, int(entry["command"]), int(entry["frame"]), parameters[:4], *parameters[4:]))
        cruise_mps = float(mission.get("cruiseSpeed", MAX_SPEED_MPS))  # type: ignore[union-attr]
    except ConfigError:
        raise
    except (AttributeError, TypeError, KeyError, ValueError, OverflowError) as error:
        raise ConfigError(source, "mission", f"is not that of a plan: {error}") from None
    return _mission(items, cruise_mps, source)


def _gpx(text: str, source: str) -> Content:
    """Read the only route or track of a GPX file."""
    try:
        import gpxpy
    except ImportError:
        raise ConfigError(source, "", 'is GPX: install the extra "gpx", gpxpy') from None
    try:
        gpx = gpxpy.parse(text)
    except (gpxpy.gpx.GPXException, ValueError) as error:
        raise ConfigError(source, "", f"is not valid GPX: {error}") from None
    paths: list[list[Any]] = [list(route.points) for route in gpx.routes]
    paths += [[point for segment in track.segments for point in segment.points] for track in gpx.tracks]
    paths = paths or [[point] for point in gpx.waypoints]
    if len(paths) != 1:
        raise ConfigError(source, "", f"must have one route or track, it has {len(paths)}")
    return None, _path((point.latitude, point.longitude) for point in paths[0])


def _geojson(text: str, source: str) -> Content:
    """Read the only LineString, or else the only Point, of the features that are no zones of a fence."""
    from ltv_mpc.geofence.geojson import check_crs, place_of

    content = config.parse_json(text, source)
    kind = content.get("type")
    features = content.get("features") if kind == "FeatureCollection" else [content]
    check_crs(content, "crs", source, [])
    found: dict[str, list[tuple[Any, Any, str]]] = {"LineString": [], "Point": []}
    for k, feature in enumerate(features if isinstance(features, list) else []):
        try:
            properties = feature.get("properties") or {}
            geometry = feature["geometry"] if feature["type"] == "Feature" else feature
            if "zone" not in properties:
                found[geometry["type"]].append((geometry["coordinates"], properties, f"features[{k}]"))
        except (AttributeError, TypeError, KeyError):
            raise ConfigError(source, f"features[{k}]", "must be a LineString, a Point, or a zone of a fence") from None
    paths = found["LineString"] or found["Point"]
    if len(paths) != 1:
        raise ConfigError(source, "features", f"must hold one LineString, or else one Point, they hold {len(paths)}")
    coordinates, properties, where = paths[0]
    at = f"{where}.geometry.coordinates"
    places = [place_of(one, at, source) for one in (coordinates if found["LineString"] else [coordinates])]
    origin = content.get("origin")
    try:
        home = None if origin is None else _origin(origin["latitude_deg"], origin["longitude_deg"])
    except (TypeError, KeyError, ValueError):
        raise ConfigError(source, "origin", "must have latitude_deg and longitude_deg") from None
    positions = [(place["latitude_deg"], place["longitude_deg"]) for place in places]
    return home, _path(positions, properties.get("speed_mps"))


READERS = {".waypoints": _waypoints, ".plan": _plan, ".gpx": _gpx, ".geojson": _geojson, ".json": _geojson}
"""Reader of each kind of file, by its suffix."""
