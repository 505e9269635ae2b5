"""Paths in files of other programs: QGroundControl plans, ArduPilot waypoints, GPX, GeoJSON.

What a file holds and a path cannot do is an error that names the item. Altitudes above home are depths if any is
negative; other altitudes are not used. A file without a speed asks for the largest one, which ``notes`` reduce to that
of the vehicle. The origin is the home of the file, else its first position.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from ltv_mpc import config
from ltv_mpc.errors import ConfigError

MAX_SPEED_MPS = 20.0
GLOBAL_FRAMES, RELATIVE_FRAMES = (0, 3, 5, 6), (3, 6)
"""MAV_FRAME of latitude and longitude, and those of them whose altitude is above home."""
WAYPOINT, LOITER, CHANGE_SPEED = 16, 17, 178
COMMANDS = {
    16: "NAV_WAYPOINT",
    17: "NAV_LOITER_UNLIM",
    18: "NAV_LOITER_TURNS",
    19: "NAV_LOITER_TIME",
    20: "NAV_RETURN_TO_LAUNCH",
    21: "NAV_LAND",
    22: "NAV_TAKEOFF",
    82: "NAV_SPLINE_WAYPOINT",
    93: "NAV_DELAY",
    177: "DO_JUMP",
    178: "DO_CHANGE_SPEED",
}
"""Names of commands (MAV_CMD) in errors."""

Position = tuple[float, float, float | None]


class Item(NamedTuple):
    """Item of a mission."""

    number: int
    command: int
    frame: int
    parameters: tuple[float, ...]  # 7, of which the last three are latitude, longitude (degrees), altitude (m)


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
    if kind in (".kml", ".kmz"):
        raise ConfigError(source, "", f"is KML: convert it, as with ogr2ogr {path.stem}.geojson {path.name}")
    if kind not in READERS:
        return None
    speed_mps, home, positions = READERS[kind](config.read_text(path, what="reference"), source)
    if not positions:
        raise ConfigError(source, "", "has no path and no point")
    latitude, longitude = home or positions[0][:2]
    table: dict[str, Any] = {"origin": {"latitude_deg": latitude, "longitude_deg": longitude}}
    dives = any(height is not None and height < 0.0 for *_, height in positions)
    places = [
        {"latitude_deg": at, "longitude_deg": on} | ({"depth_m": max(-(height or 0.0), 0.0)} if dives else {})
        for at, on, height in positions
    ]
    if len(places) == 1:
        return table | {"kind": "point"} | places[0]
    return table | {
        "kind": "waypoints",
        "speed_mps": MAX_SPEED_MPS if speed_mps is None else speed_mps,
        "waypoints": places,
    }


Content = tuple[float | None, Sequence[float] | None, list[Position]]
"""Speed (m/s), home (latitude and longitude, degrees) if the file has them, and positions."""


def _from_items(items: Iterable[Item], source: str) -> tuple[float | None, list[Position]]:
    """Return speed and positions of a mission."""
    speed_mps: float | None = None
    positions: list[Position] = []
    refused, endless = [], False
    for number, command, frame, (wait_s, speed, *_, latitude, longitude, height) in items:
        why = ""
        if command == CHANGE_SPEED:
            if positions and speed > 0.0 and speed != speed_mps:
                why = "a path has one speed"
            speed_mps = speed if speed > 0.0 else speed_mps
        elif command not in (WAYPOINT, LOITER):
            why = "a path has positions alone"
        elif endless:
            why = "it follows an item without an end"
        elif frame not in GLOBAL_FRAMES:
            why = f"its frame {frame} is not global"
        elif command == WAYPOINT and wait_s > 0.0:
            why = f"a path does not wait, here {wait_s:g} s"
        else:
            positions.append((latitude, longitude, height if frame in RELATIVE_FRAMES else None))
            endless = command == LOITER
        if why:
            refused.append(f"item {number} {COMMANDS.get(command, 'MAV_CMD')} ({command}): {why}")
    if refused:
        raise ConfigError(source, "", f"cannot be followed: {'; '.join(refused[:10])}")
    return speed_mps, positions


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
            cells = [float(cell) for cell in line.split()]
            if cells:
                number, _, frame, command, *parameters, _ = cells
                items.append(Item(int(number), int(command), int(frame), tuple(parameters)))
            if cells and len(cells) != 12:
                raise ValueError
        except (ValueError, OverflowError):
            raise ConfigError(source, f"line {k}", "must have 12 numbers", value=line[:60]) from None
    if not items:
        raise ConfigError(source, "", "has no items")
    return items


def read_json(text: str, source: str) -> dict[str, Any]:
    """Return the object of a JSON file.

    Parameters
    ----------
    text : content of the file.
    source : name of the file in errors.
    """
    try:
        content = msgspec.json.decode(text)
    except (msgspec.DecodeError, RecursionError) as error:
        raise ConfigError(source, "", f"is not valid JSON: {error}") from None
    if not isinstance(content, dict):
        raise ConfigError(source, "", "must be a JSON object")
    return content


def _waypoints(text: str, source: str) -> Content:
    home, *items = read_waypoints(text, source)
    speed_mps, positions = _from_items(items, source)
    return speed_mps, home.parameters[4:6], positions


def _plan(text: str, source: str) -> Content:
    """Read a QGroundControl plan."""
    mission, items = read_json(text, source).get("mission"), []
    try:
        for k, entry in enumerate(mission["items"], start=1):  # type: ignore[index]
            number = int(entry.get("doJumpId", k))
            if entry["type"] != "SimpleItem":
                name = entry.get("complexItemType", entry["type"])
                raise ConfigError(source, f"item {number}", f"{name} cannot be followed: give its waypoints")
            parameters = tuple(float(number or 0.0) for number in entry["params"])
            if len(parameters) != 7:
                raise ValueError(f"item {number} has {len(parameters)} of 7 parameters")
            items.append(Item(number, int(entry["command"]), int(entry["frame"]), parameters))
        home = [float(number) for number in mission["plannedHomePosition"][:2]]  # type: ignore[index]
        cruise_mps = mission.get("cruiseSpeed")  # type: ignore[union-attr]
    except (AttributeError, TypeError, KeyError, ValueError, OverflowError) as error:
        raise ConfigError(source, "mission", f"is not that of a plan: {error}") from None
    speed_mps, positions = _from_items(items, source)
    return cruise_mps if speed_mps is None else speed_mps, home, positions


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
    return None, None, [(point.latitude, point.longitude, None) for point in paths[0]]


def _geojson(text: str, source: str) -> Content:
    """Read the only LineString, or else the only Point, of the features that are no zones of a fence."""
    from ltv_mpc.geofence.geojson import check_crs, place_of

    content = read_json(text, source)
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
        home = None if origin is None else (origin["latitude_deg"], origin["longitude_deg"])
    except (TypeError, KeyError):
        raise ConfigError(source, "origin", "must have latitude_deg and longitude_deg") from None
    positions: list[Position] = [(place["latitude_deg"], place["longitude_deg"], None) for place in places]
    return properties.get("speed_mps"), home, positions


READERS = {".waypoints": _waypoints, ".plan": _plan, ".gpx": _gpx, ".geojson": _geojson, ".json": _geojson}
"""Reader of each kind of file, by its suffix."""
