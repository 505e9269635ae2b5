"""GeoJSON (RFC 7946) of a fence: a FeatureCollection whose features have a property ``zone``.

    zone             geometry           further properties
    keep_in          Polygon            name, margin_m
    keep_out         Polygon            name, margin_m
    keep_out_disc    Point              name, margin_m, radius_m

Coordinates are longitude and latitude (degrees) on WGS 84; a ``crs`` (GeoJSON of 2008) with another datum is an error.
Repeated positions of a ring count as one. The polygons of a MultiPolygon are keep-out zones of their own; those of a
keep-in zone are an area in which the vehicle stays: two keep-in zones would leave their common part alone. What such an
area leaves out, its holes and the space between its parts, are keep-out zones. The collection's own members
``margin_m`` and ``origin`` are those of the fence. Other properties, such as colours, and properties that are null are
ignored: programs that draw maps add them. A LineString or a Point without a ``zone`` is a reference; so is a
MultiLineString of one line, cut at the antimeridian for example.
"""

from __future__ import annotations

import contextlib
import itertools
import math
import re
from typing import Any, NamedTuple, TypeAlias

import msgspec
import numpy as np
import shapely
from shapely.affinity import scale

from ltv_mpc import config
from ltv_mpc.errors import ConfigError
from ltv_mpc.references.mission_files import note_unused

GEOMETRY = {"keep_in": "Polygon", "keep_out": "Polygon", "keep_out_disc": "Point"}
"""Type of the geometry by zone."""

REFERENCES = ("LineString", "Point")
"""Types of the geometry of a reference."""

PROPERTIES = ("name", "margin_m", "radius_m")
"""Properties of a feature that a fence has, besides ``zone``."""

ORDER = "positions are [longitude, latitude]"
"""Reminder in errors of positions that are far away: a program may have written the latitude first."""

GRID_DEG = 1e-8
"""Distance (degrees; 1 mm) below which corners of an area count as one: slivers are no zones."""

MAX_DEG = 360.0
"""Largest longitude and latitude: maps write up to a turn more, and larger numbers are no degrees."""

AROUND = (1.05, 1.1)
"""Sizes of two boxes around the parts of an area, over that of the area: the keep-in zone, and what is kept out."""

CRS = {"CRS84": 0.0, "4326": 0.0, "4258": 1.0, "4269": 2.0}
"""Largest distance (m) between WGS 84 and coordinate reference systems that are read: itself, ETRS89 and NAD83."""

Names: TypeAlias = dict[str, str]
"""Names of features by those of zones, as ``fence.toml`` holds them: ``keep_in[0]`` or ``[keep_in.0]``."""

Ring: TypeAlias = list[dict[str, float]]
"""Vertices of a ring: latitude_deg and longitude_deg."""


def parse(content_text: str | bytes, source: str, notes: list[str]) -> tuple[dict[str, Any], Names]:
    """Return the table of a fence, as ``fence.toml`` holds it, and the names of its features.

    Raises ``ConfigError``.

    Parameters
    ----------
    content_text : GeoJSON.
    source : name of the text in errors.
    notes : receives a sentence about coordinates that are not exactly those of WGS 84.
    """
    content, features = features_of(content_text, source, notes)
    table: dict[str, Any] = {key: content[key] for key in ("margin_m", "origin") if key in content}
    names: Names = {}
    zones = [feature for feature in features if not feature.is_reference]
    note_unused(source, notes, features_of_a_reference=len(features) - len(zones))
    for feature in zones:
        for zone, entries in _entries(feature, source).items():
            for i, entry in enumerate(entries, start=len(table.setdefault(zone, []))):
                table[zone].append(entry)
                names |= dict.fromkeys((f"{zone}[{i}]", f"[{zone}.{i}]"), feature.where)
    return table, names


class Feature(NamedTuple):
    """Feature of GeoJSON, or a geometry alone."""

    where: str  # names it in errors
    properties: dict[str, Any]
    shape: Any  # shapely geometry: longitude and latitude (degrees), perhaps heights

    @property
    def is_reference(self) -> bool:
        """True for a LineString or a Point without a ``zone``."""
        return self.shape.geom_type in REFERENCES and "zone" not in self.properties


def features_of(text: str | bytes, source: str, notes: list[str]) -> tuple[dict[str, Any], list[Feature]]:
    """Return the content and the features of a GeoJSON text. Raises ``ConfigError``.

    Parameters
    ----------
    text : GeoJSON: a collection, one feature, or a geometry.
    source : name of the text in errors.
    notes : receives a sentence about coordinates that are not exactly those of WGS 84.
    """
    content = config.parse_json(text, source)
    of, features = [content], []
    if content.get("type") == "FeatureCollection":
        of = content.get("features")  # type: ignore[assignment]
        check_crs(content, "crs", source, notes)
    if not isinstance(of, list):
        raise ConfigError(source, "features", "must be a list of features")
    for k, feature in enumerate(of):
        where = f"features[{k}]"
        try:
            geometry = feature["geometry"] if feature["type"] == "Feature" else feature
            properties = dict(feature.get("properties") or {})
            if geometry is None and "zone" not in properties:
                notes.append(f"{source}: {where}: has no geometry and is not used")
                continue
            coordinates = _without_measures(geometry["coordinates"])
            parts = msgspec.json.encode({"type": geometry["type"], "coordinates": coordinates})
        except (AttributeError, TypeError, KeyError, ValueError, RecursionError):
            raise ConfigError(source, where, "must be a Feature with properties and a geometry") from None
        if coordinates != geometry["coordinates"]:
            notes.append(f"{source}: {where}: numbers of its positions behind the third are not used")
        check_crs(feature, f"{where}.crs", source, notes)
        check_crs(geometry if geometry is not feature else None, f"{where}.geometry.crs", source, notes)
        try:
            shape = shapely.from_geojson(parts)
        except shapely.GEOSException as error:
            reason = str(error).partition(": ")[2].strip()  # behind the name of an exception of GEOS
            raise ConfigError(source, f"{where}.geometry", f"is no geometry of GeoJSON: {reason}") from None
        if (np.abs(shapely.total_bounds(shape)) > MAX_DEG).any():
            problem = f"must be longitude and latitude in degrees, at most {MAX_DEG:g}"
            raise ConfigError(source, f"{where}.geometry", problem)
        features.append(Feature(where, properties, _joined(shape)))
    return content, features


def _joined(shape: Any) -> Any:
    """Return a MultiLineString whose parts begin where the one before ends, as ogr2ogr writes tracks, as LineString."""
    if shape.geom_type != "MultiLineString" or shape.is_empty:
        return shape
    parts = [shapely.get_coordinates(part, include_z=shape.has_z) for part in shape.geoms if not part.is_empty]
    gaps = (after[0] - before[-1] for before, after in itertools.pairwise(parts))
    if any(math.remainder(gap[0], 360.0) or gap[1] for gap in gaps):
        return shape
    return shapely.LineString(np.concatenate([parts[0], *(part[1:] for part in parts[1:])]))


def _without_measures(coordinates: Any) -> Any:
    """Return coordinates with three numbers of each position at most: what the others mean is not defined."""
    if isinstance(coordinates, list) and any(isinstance(part, list) for part in coordinates):
        return [_without_measures(part) for part in coordinates]
    return coordinates[:3] if isinstance(coordinates, list) else coordinates


def check_crs(of: Any, where: str, source: str, notes: list[str]) -> None:
    """Reject coordinates with another datum than WGS 84, and note those that are nearly the same.

    Parameters
    ----------
    of : object of GeoJSON that may have a ``crs``.
    where, source : name of the member and of the text in errors.
    notes : receives a sentence about a datum that is nearly the same.
    """
    crs = of.get("crs") if isinstance(of, dict) else None
    if crs is None:
        return
    name = str(crs)
    with contextlib.suppress(TypeError, KeyError):
        name = str(crs["properties"]["name"])
    off_m = CRS.get(name.rsplit(":", 1)[-1].upper())
    if off_m is None:
        problem = "must be CRS84 or EPSG:4326 (WGS 84): convert it, as with ogr2ogr -t_srs EPSG:4326"
        raise ConfigError(source, where, problem, value=name[:80])
    if off_m:
        notes.append(f"{source}: {where} {name} is read as WGS 84, from which it differs by up to about {off_m:g} m")


def with_features(error: ConfigError, names: Names) -> ConfigError:
    """Return an error about the table of a fence that names the features of the GeoJSON text instead.

    Parameters
    ----------
    error : names zones.
    names : as ``parse`` returns them.
    """

    def named(text: str) -> str:
        """Return a text with the names of features."""
        return re.sub(r"\w+\[\d+\]|\[\w+\.\d+\]", lambda match: names.get(match[0], match[0]), text)

    far = "from the origin" in error.problem or ".latitude_deg" in error.field
    problem = f"{error.problem}; {ORDER}" if far else error.problem
    return ConfigError(error.source, named(error.field), named(problem), value=error.value)


def _entries(feature: Feature, source: str) -> dict[str, list[dict[str, Any]]]:
    """Return the entries of one feature by their table."""
    zone, kind, at = feature.properties.get("zone"), feature.shape.geom_type, f"{feature.where}.geometry"
    if not isinstance(zone, str) or zone not in GEOMETRY:
        problem = f"must be one of {', '.join(GEOMETRY)}"
        raise ConfigError(source, f"{feature.where}.properties.zone", problem, value=zone)
    if kind != GEOMETRY[zone] and (kind, zone == "keep_out_disc") != ("MultiPolygon", False):
        raise ConfigError(source, f"{at}.type", f'must be "{GEOMETRY[zone]}" for {zone}', value=kind)
    if feature.shape.is_empty:
        raise ConfigError(source, f"{at}.coordinates", "are missing")
    properties = {key: feature.properties[key] for key in PROPERTIES if feature.properties.get(key) is not None}
    try:
        parts = shapely.get_parts(shapely.remove_repeated_points(shapely.force_2d(feature.shape))).tolist()
    except shapely.GEOSException:
        raise ConfigError(source, f"{at}.coordinates", "must have at least 3 different positions in a ring") from None
    if kind == "Point":
        return {zone: [{**properties, "centre": places_of(parts[0])[0]}]}
    if zone == "keep_in":
        zones = zones_around([[part] for part in parts], at, source)
    elif any(part.interiors for part in parts):
        raise ConfigError(source, at, "must have no hole for keep_out: the vehicle cannot come into it")
    else:
        zones = {zone: [places_of(part.exterior)[:-1] for part in parts]}
    return {table: [{**properties, "vertices": ring} for ring in rings] for table, rings in zones.items()}


def zones_around(groups: list[list[Any]], where: str, source: str) -> dict[str, list[Ring]]:
    """Return the rings of the zones that leave the common area of the polygons of any group allowed.

    The keep-in zone is the area's outline, or a box around all its parts. What it has beside the area is keep-out
    zones, of which those with a hole are cut through it.

    Parameters
    ----------
    groups : shapely polygons (degrees) of each group. A group without a common area, which nothing could be in, stands
        for the union of its polygons.
    where, source : name of the polygons and of the text in errors.
    """
    if len(groups) == len(groups[0]) == 1 and not groups[0][0].interiors:
        return {"keep_in": [places_of(groups[0][0].exterior)[:-1]]}
    areas, longitude_deg = [], shapely.get_coordinates(groups[0])[0, 0]
    for group in groups:
        group = [_on_one_side(polygon, longitude_deg) for polygon in group]
        if not all(polygon.is_valid for polygon in group):
            raise ConfigError(source, where, "; ".join(map(shapely.is_valid_reason, group)))
        common = shapely.intersection_all(group)
        areas.append(common if common.area > 0.0 else shapely.union_all(group))
    area = shapely.MultiPolygon(_polygons(shapely.union_all(areas, grid_size=GRID_DEG)))
    outline = around = shapely.Polygon(area.geoms[0].exterior)
    if len(area.geoms) > 1:  # long edges along one another in degrees are not quite so in metres
        outline, around = (scale(area.envelope, factor, factor) for factor in AROUND)
    beside, gaps = [], _polygons(shapely.difference(around, area, grid_size=GRID_DEG))
    for gap in gaps:
        if not gap.interiors:
            beside.append(gap)
            continue
        west, south, east, north = gap.bounds
        middle = gap.interiors[0].centroid.x
        for half in (shapely.box(west, south, middle, north), shapely.box(middle, south, east, north)):
            gaps += _polygons(shapely.intersection(gap, half, grid_size=GRID_DEG))
    zones = {"keep_in": [outline], "keep_out": beside}
    return {zone: [places_of(polygon.exterior)[:-1] for polygon in polygons] for zone, polygons in zones.items()}


def _on_one_side(polygon: Any, longitude_deg: float) -> Any:
    """Return a polygon (degrees) whose longitudes differ from another one by half a turn at most."""
    return shapely.transform(polygon, lambda at: at - [360.0, 0.0] * np.round((at - longitude_deg) / 360.0))


def _polygons(geometry: Any) -> list[Any]:
    """Return the polygons of a geometry, which may be empty or have lines and points beside them."""
    return [part for part in shapely.get_parts(geometry) if part.area > 0.0]


def places_of(shape: Any) -> Ring:
    """Return the positions of a shapely geometry (longitude and latitude, degrees) as places.

    A longitude of 181 degrees, which maps write behind the antimeridian, is -179.

    Parameters
    ----------
    shape : a ring repeats its first position.
    """
    places = shapely.get_coordinates(shape).tolist()
    return [{"longitude_deg": math.remainder(on, 360.0), "latitude_deg": at} for on, at in places]
