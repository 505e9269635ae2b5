"""GeoJSON (RFC 7946) of a fence: a FeatureCollection whose features have a property ``zone``.

    zone             geometry           further properties
    keep_in          Polygon            name, margin_m
    keep_out         Polygon            name, margin_m
    keep_out_disc    Point              name, margin_m, radius_m

Coordinates are longitude and latitude (degrees). A polygon has one ring; a MultiPolygon of one polygon counts as that
polygon. The collection's own members ``margin_m`` and ``origin`` are those of the fence. Other properties, such as
colours, and properties that are null are ignored: programs that draw maps add them.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, TypeAlias

import msgspec

from ltv_mpc.errors import ConfigError
from ltv_mpc.references.geodesy import Origin, Place, degrees, local

GEOMETRY = {"keep_in": "Polygon", "keep_out": "Polygon", "keep_out_disc": "Point"}
"""Type of the geometry by zone."""

PROPERTIES = ("name", "margin_m", "radius_m")
"""Properties of a feature that a fence has, besides ``zone``."""

ORDER = "positions are [longitude, latitude]"
"""Reminder in errors of positions that are far away: a program may have written the latitude first."""

Numbers: TypeAlias = dict[str, list[int]]
"""Numbers of the features of each kind of zone, in their order."""


def parse(content_text: str | bytes, source: str) -> tuple[dict[str, Any], Numbers]:
    """Return the table of a fence, as ``fence.toml`` holds it, and the numbers of its features.

    Raises ``ConfigError``.

    Parameters
    ----------
    content_text : GeoJSON.
    source : name of the text in errors.
    """
    try:
        content = msgspec.json.decode(content_text)
    except (msgspec.DecodeError, RecursionError) as error:
        raise ConfigError(source, "", f"is not valid JSON: {error}") from None
    if not isinstance(content, dict) or content.get("type") != "FeatureCollection":
        raise ConfigError(source, "type", 'must be "FeatureCollection"')
    features = content.get("features")
    if not isinstance(features, list):
        raise ConfigError(source, "features", "must be a list of features")
    table: dict[str, Any] = {key: content[key] for key in ("margin_m", "origin") if key in content}
    numbers: Numbers = {}
    for k, feature in enumerate(features):
        zone, entry = _entry(feature, f"features[{k}]", source)
        table.setdefault(zone, []).append(entry)
        numbers.setdefault(zone, []).append(k)
    return table, numbers


def with_features(error: ConfigError, numbers: Numbers) -> ConfigError:
    """Return an error about the table of a fence that names the features of the GeoJSON text instead.

    Parameters
    ----------
    error : names zones as ``fence.toml`` holds them, ``keep_in[0]`` or ``[keep_in.0]``.
    numbers : as ``parse`` returns them.
    """
    names = {
        written: f"features[{k}]"
        for zone, features in numbers.items()
        for i, k in enumerate(features)
        for written in (f"{zone}[{i}]", f"[{zone}.{i}]")
    }

    def named(text: str) -> str:
        """Return a text with the names of features."""
        return re.sub(r"\w+\[\d+\]|\[\w+\.\d+\]", lambda match: names.get(match[0], match[0]), text)

    far = "from the origin" in error.problem or ".latitude_deg" in error.field
    problem = f"{error.problem}; {ORDER}" if far else error.problem
    return ConfigError(error.source, named(error.field), named(problem), value=error.value)


def _entry(feature: Any, where: str, source: str) -> tuple[str, dict[str, Any]]:
    """Return table and entry of one feature."""
    try:
        given, geometry = dict(feature["properties"]), feature["geometry"]
        kind, coordinates = geometry["type"], geometry["coordinates"]
    except (TypeError, KeyError, ValueError):
        raise ConfigError(source, where, "must be a Feature with properties and a geometry") from None
    zone = given.get("zone")
    properties = {key: given[key] for key in PROPERTIES if given.get(key) is not None}
    if not isinstance(zone, str) or zone not in GEOMETRY:
        raise ConfigError(source, f"{where}.properties.zone", f"must be one of {', '.join(GEOMETRY)}", value=zone)
    if kind == "MultiPolygon":
        if not isinstance(coordinates, list) or len(coordinates) != 1:
            problem = "must be one polygon: give each polygon a feature of its own"
            raise ConfigError(source, f"{where}.geometry.coordinates", problem)
        kind, coordinates = "Polygon", coordinates[0]
    if kind != GEOMETRY[zone]:
        raise ConfigError(source, f"{where}.geometry.type", f'must be "{GEOMETRY[zone]}" for {zone}', value=kind)
    if kind == "Point":
        return zone, {**properties, "centre": _place(coordinates, f"{where}.geometry.coordinates", source)}
    if not isinstance(coordinates, list) or len(coordinates) != 1:
        problem = "must be one ring: a hole is a zone of its own"
        raise ConfigError(source, f"{where}.geometry.coordinates", problem)
    ring = coordinates[0]
    if not isinstance(ring, list) or len(ring) < 4 or ring[0] != ring[-1]:
        problem = "must be a closed ring of at least 3 vertices: the last position repeats the first"
        raise ConfigError(source, f"{where}.geometry.coordinates[0]", problem)
    at = f"{where}.geometry.coordinates[0]"
    places = [_place(position, f"{at}[{i}]", source) for i, position in enumerate(ring[:-1])]
    return zone, {**properties, "vertices": places}


def _place(position: Any, where: str, source: str) -> dict[str, float]:
    """Return a position [longitude, latitude, ...] as a place."""
    numbers = isinstance(position, list) and len(position) >= 2 and all(type(x) in (int, float) for x in position)
    if not numbers:
        raise ConfigError(source, where, "must be [longitude, latitude] in degrees", value=position)
    return {"longitude_deg": float(position[0]), "latitude_deg": float(position[1])}


def text(table: Mapping[str, Any], origin: Origin | None, source: str) -> str:
    """Return the GeoJSON text of a fence. Raises ``ConfigError`` without an origin.

    Parameters
    ----------
    table : the fence, as ``fence.toml`` holds it.
    origin : position of north = east = 0.
    source : name of the file in errors.
    """
    if origin is None:
        raise ConfigError(source, "[origin]", "is missing: GeoJSON has positions in degrees")
    features = []
    for zone, kind in GEOMETRY.items():
        for entry in table.get(zone, ()):
            properties = {key: value for key, value in entry.items() if key not in ("vertices", "centre")}
            if kind == "Point":
                coordinates: Any = _position(entry["centre"], origin)
            else:
                ring = [_position(place, origin) for place in entry["vertices"]]
                coordinates = [[*ring, ring[0]]]
            geometry = {"type": kind, "coordinates": coordinates}
            features.append({"type": "Feature", "properties": {"zone": zone, **properties}, "geometry": geometry})
    content = {"type": "FeatureCollection", "features": features}
    content |= {key: table[key] for key in ("margin_m", "origin") if key in table}
    return msgspec.json.format(msgspec.json.encode(content), indent=1).decode() + "\n"


def _position(place: Mapping[str, float], origin: Origin) -> list[float]:
    """Return [longitude, latitude] (degrees) of a place."""
    if "latitude_deg" in place:
        return [place["longitude_deg"], place["latitude_deg"]]
    latitude, longitude = degrees(*local(msgspec.convert(place, Place), origin), origin)
    return [longitude, latitude]
