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
ignored: programs that draw maps add them. A LineString or a Point without a ``zone`` is a reference.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping
from typing import Any, TypeAlias

import msgspec

from ltv_mpc import config
from ltv_mpc.errors import ConfigError
from ltv_mpc.references.geodesy import Origin, Place, degrees, local
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

AROUND = (1.05, 1.1)
"""Sizes of two boxes around the parts of an area, over that of the area: the keep-in zone, and what is kept out."""

CRS = {"CRS84": 0.0, "4326": 0.0, "4258": 1.0, "4269": 2.0}
"""Largest distance (m) between WGS 84 and coordinate reference systems that are read: itself, ETRS89 and NAD83."""

Numbers: TypeAlias = dict[str, list[int]]
"""Numbers of the features of each kind of zone, in their order."""

Ring: TypeAlias = list[dict[str, float]]
"""Vertices of a ring: latitude_deg and longitude_deg."""


def parse(content_text: str | bytes, source: str, notes: list[str]) -> tuple[dict[str, Any], Numbers]:
    """Return the table of a fence, as ``fence.toml`` holds it, and the numbers of its features.

    Raises ``ConfigError``.

    Parameters
    ----------
    content_text : GeoJSON.
    source : name of the text in errors.
    notes : receives a sentence about coordinates that are not exactly those of WGS 84.
    """
    content = config.parse_json(content_text, source)
    if content.get("type") != "FeatureCollection":
        raise ConfigError(source, "type", 'must be "FeatureCollection"')
    features = content.get("features")
    if not isinstance(features, list):
        raise ConfigError(source, "features", "must be a list of features")
    table: dict[str, Any] = {key: content[key] for key in ("margin_m", "origin") if key in content}
    numbers: Numbers = {}
    check_crs(content, "crs", source, notes)
    paths = 0
    for k, feature in enumerate(features):
        if _is_reference(feature):
            paths += 1
            continue
        for zone, entries in _entries(feature, f"features[{k}]", source, notes).items():
            table.setdefault(zone, []).extend(entries)
            numbers.setdefault(zone, []).extend([k] * len(entries))
    note_unused(source, notes, features_of_a_reference=paths)
    return table, numbers


def _is_reference(feature: Any) -> bool:
    """Return True for a LineString or a Point without a ``zone``."""
    try:
        return feature["geometry"]["type"] in REFERENCES and "zone" not in (feature["properties"] or {})
    except (TypeError, KeyError):
        return False


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
    try:
        name = str(crs["properties"]["name"])
    except (TypeError, KeyError):
        name = str(crs)
    off_m = CRS.get(name.rsplit(":", 1)[-1].upper())
    if off_m is None:
        problem = "must be CRS84 or EPSG:4326 (WGS 84): convert it, as with ogr2ogr -t_srs EPSG:4326"
        raise ConfigError(source, where, problem, value=name[:80])
    if off_m:
        notes.append(f"{source}: {where} {name} is read as WGS 84, from which it differs by up to about {off_m:g} m")


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


def _entries(feature: Any, where: str, source: str, notes: list[str]) -> dict[str, list[dict[str, Any]]]:
    """Return the entries of one feature by their table."""
    try:
        given, geometry = dict(feature["properties"]), feature["geometry"]
        kind, coordinates = geometry["type"], geometry["coordinates"]
    except (TypeError, KeyError, ValueError):
        raise ConfigError(source, where, "must be a Feature with properties and a geometry") from None
    check_crs(feature, f"{where}.crs", source, notes)
    check_crs(geometry, f"{where}.geometry.crs", source, notes)
    zone, at = given.get("zone"), f"{where}.geometry.coordinates"
    properties = {key: given[key] for key in PROPERTIES if given.get(key) is not None}
    if not isinstance(zone, str) or zone not in GEOMETRY:
        raise ConfigError(source, f"{where}.properties.zone", f"must be one of {', '.join(GEOMETRY)}", value=zone)
    if kind != GEOMETRY[zone] and (kind, zone == "keep_out_disc") != ("MultiPolygon", False):
        raise ConfigError(source, f"{where}.geometry.type", f'must be "{GEOMETRY[zone]}" for {zone}', value=kind)
    if kind == "Point":
        return {zone: [{**properties, "centre": place_of(coordinates, at, source)}]}
    if not isinstance(coordinates, list) or not coordinates:
        raise ConfigError(source, at, "must be a list of rings or polygons")
    polygons = [(at, coordinates)]
    if kind == "MultiPolygon":
        polygons = [(f"{at}[{i}]" if len(coordinates) > 1 else at, polygon) for i, polygon in enumerate(coordinates)]
    rings = [_rings(polygon, of, source) for of, polygon in polygons]
    if zone == "keep_in":
        zones = zones_around([[polygon] for polygon in rings], at, source)
        return {table: [{**properties, "vertices": ring} for ring in found] for table, found in zones.items()}
    holes = next((of for (of, _), polygon in zip(polygons, rings, strict=True) if len(polygon) > 1), "")
    if holes:
        raise ConfigError(source, holes, "must be one ring for keep_out: the vehicle cannot come into a hole")
    return {zone: [{**properties, "vertices": ring} for (ring,) in rings]}


def _rings(polygon: Any, where: str, source: str) -> list[Ring]:
    """Return the vertices of the rings of a polygon without repeated ones."""
    if not isinstance(polygon, list) or not polygon:
        raise ConfigError(source, where, "must be a list of rings")
    rings = []
    for k, places in enumerate(polygon):
        at = f"{where}[{k}]"
        if isinstance(places, list):
            places = [place_of(position, f"{at}[{i}]", source) for i, position in enumerate(places)]
        if not isinstance(places, list) or len(places) < 4 or places[0] != places[-1]:
            problem = "must be a closed ring of at least 3 vertices: the last position repeats the first"
            raise ConfigError(source, at, problem)
        rings.append([place for place, following in itertools.pairwise(places) if place != following])
    return rings


def zones_around(groups: list[list[list[Ring]]], where: str, source: str) -> dict[str, list[Ring]]:
    """Return the rings of the zones that leave the common area of the polygons of any group allowed.

    The keep-in zone is the area's outline, or a box around all its parts. What it has beside the area is keep-out
    zones, of which those with a hole are cut through it.

    Parameters
    ----------
    groups : polygons of each group: their outline, and their holes. A group without a common area, which nothing could
        be in, stands for the union of its polygons.
    where, source : name of the polygons and of the text in errors.
    """
    if len(groups) == len(groups[0]) == len(groups[0][0]) == 1:
        return {"keep_in": groups[0][0]}
    import shapely  # as long as the start of a process, and rarely needed
    from shapely.affinity import scale

    areas = []
    for group in groups:
        polygons = [_polygon(rings, where, source) for rings in group]
        common = shapely.intersection_all(polygons)
        areas.append(common if common.area > 0.0 else shapely.union_all(polygons))
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
            gaps += _polygons(gap & half)
    return {"keep_in": [_vertices(outline)], "keep_out": [_vertices(gap) for gap in beside]}


def _polygon(rings: list[Ring], where: str, source: str) -> Any:
    """Return the shapely.Polygon of an outline and its holes."""
    import shapely

    outline, *holes = ([(place["longitude_deg"], place["latitude_deg"]) for place in ring] for ring in rings)
    polygon = shapely.Polygon(outline, holes) if len(outline) > 2 else shapely.Polygon()
    if polygon.is_empty or not polygon.is_valid:
        raise ConfigError(
            source, where, f"has no simple polygon: {shapely.is_valid_reason(polygon)}", value=outline[:1]
        )
    return polygon


def _polygons(geometry: Any) -> list[Any]:
    """Return the polygons of a geometry, which may be empty or have lines and points beside them."""
    import shapely

    return [part for part in shapely.get_parts(geometry) if part.area > 0.0]


def _vertices(polygon: Any) -> Ring:
    return [{"longitude_deg": on, "latitude_deg": at} for on, at in polygon.exterior.coords[:-1]]


def place_of(position: Any, where: str, source: str) -> dict[str, float]:
    """Return a position [longitude, latitude, ...] as a place.

    Parameters
    ----------
    position : decoded JSON.
    where, source : name of the position and of the text in errors.
    """
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
