"""Fence: keep-in and keep-out zones in metres or degrees, read from ``fence.toml`` or GeoJSON.

The vehicle has to stay inside every keep-in polygon and outside every keep-out polygon and disc. The margin of a zone
is the distance between its boundary and the hull that is kept free.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
import pymap3d
from msgspec import Meta

from ltv_mpc import config
from ltv_mpc.errors import ConfigError, naming
from ltv_mpc.messages import Array, ZoneInForce
from ltv_mpc.references.base import BaseReference
from ltv_mpc.references.geodesy import Origin, Place, local
from ltv_mpc.validation import MAX_VERTICES
from ltv_mpc.vehicle.parameters import Vehicle

MAX_ZONES = 100
"""Largest number of zones of one kind."""

MAX_ORIGIN_DISTANCE_M = 1.0
"""Largest distance between the origins of a fence and a reference."""

MIN_LENGTH_M = 1e-3
"""Shortest edge of a ring."""

GEOJSON = (".geojson", ".json")
"""Suffixes of a GeoJSON file; every other file is TOML."""


class Zone(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """Part of a fence."""

    name: Annotated[str, Meta(max_length=100)] = ""
    margin_m: Annotated[float, Meta(ge=0, le=1000)] | None = None  # None: that of the fence


class Polygon(Zone, frozen=True, kw_only=True, omit_defaults=True):
    """Polygon, convex or concave; the last edge leads back to the first vertex."""

    vertices: Annotated[tuple[Place, ...], Meta(min_length=3, max_length=MAX_VERTICES)]


class Disc(Zone, frozen=True, kw_only=True, omit_defaults=True):
    """Disc."""

    centre: Place
    radius_m: Annotated[float, Meta(gt=0, le=100_000)]


class Fence(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """Geofence of a mission."""

    margin_m: Annotated[float, Meta(ge=0, le=1000)]  # of zones that have none of their own
    origin: Origin | None = None  # position of north = east = 0, for places in degrees
    keep_in: Annotated[tuple[Polygon, ...], Meta(max_length=MAX_ZONES)] = ()
    keep_out: Annotated[tuple[Polygon, ...], Meta(max_length=MAX_ZONES)] = ()
    keep_out_disc: Annotated[tuple[Disc, ...], Meta(max_length=MAX_ZONES)] = ()

    def __post_init__(self) -> None:
        """Reject places without coordinates, rings that are no simple polygon, and a fence without zones."""
        if not (self.keep_in or self.keep_out or self.keep_out_disc):
            raise ValueError("no zone: give at least one of [[keep_in]], [[keep_out]], [[keep_out_disc]]")
        for zone in self.zones():
            problem = "" if zone.radius_m > 0.0 else ring_problem(zone.vertices_m)
            if problem:
                raise ValueError(f"{zone.label}: {problem}")

    @classmethod
    def load(cls, path: str, notes: list[str] | None = None, origin: Origin | None = None) -> Fence:
        """Read a fence: GeoJSON, .plan or .waypoints by the file's suffix, else TOML. Raises ``ConfigError``.

        Parameters
        ----------
        path : of the file.
        notes : as in ``from_geojson``.
        origin : that of the reference, for a list of fence items without home.
        """
        from ltv_mpc.geofence import fence_files  # shapely takes a tenth of a second

        source = f"fence {path}"
        if path.lower().endswith(GEOJSON):
            return cls.from_geojson(config.read_text(Path(path), what="fence"), source, notes)
        table = fence_files.read(Path(path), source, [] if notes is None else notes, origin)
        return config.parse(table or config.read_toml(Path(path), what="fence"), cls, source=source)

    @classmethod
    def from_geojson(cls, text: str, source: str = "fence", notes: list[str] | None = None) -> Fence:
        """Read a fence from the text of a GeoJSON file. Raises ``ConfigError``.

        Parameters
        ----------
        text : contents of the file.
        source : name of the text in errors.
        notes : receives a sentence about coordinates that are not exactly those of WGS 84.
        """
        from ltv_mpc.geofence import geojson

        table, names = geojson.parse(text, source, [] if notes is None else notes)
        try:
            return config.parse(table, cls, source=source)
        except ConfigError as error:
            raise geojson.with_features(error, names) from None

    def zones(self) -> Iterator[ZoneInForce]:
        """Yield the zones in the local frame: keep-in polygons, keep-out polygons, keep-out discs."""
        for table in ("keep_in", "keep_out", "keep_out_disc"):
            zones: tuple[Polygon | Disc, ...] = getattr(self, table)
            for k, zone in enumerate(zones):
                label = f'{table}[{k}] "{zone.name}"' if zone.name else f"{table}[{k}]"
                yield self._in_force(zone, label, keep_in=table == "keep_in")

    def _in_force(self, zone: Polygon | Disc, label: str, *, keep_in: bool) -> ZoneInForce:
        """Return a zone in the local frame; whole numbers become floats, for which alone kernels are compiled."""
        if isinstance(zone, Disc):
            radius_m, vertices = zone.radius_m, [self._local(zone.centre, f"{label}: centre")]
        else:
            places = enumerate(zone.vertices)
            radius_m, vertices = 0.0, [self._local(place, f"{label}: vertices[{i}]") for i, place in places]
        return ZoneInForce(
            label=label,
            keep_in=keep_in,
            vertices_m=np.array(vertices, dtype=float),
            radius_m=float(radius_m),
            margin_m=float(self.margin_m if zone.margin_m is None else zone.margin_m),
        )

    def _local(self, place: Place, where: str) -> tuple[float, float]:
        if place.depth_m is not None:
            raise ValueError(f"{where}: depth_m is not used: a zone reaches from the surface to the bottom")
        with naming(where):
            return local(place, self.origin)


def ring_problem(vertices: Array) -> str:
    """Return what is wrong with a ring as text; empty for a simple polygon.

    Parameters
    ----------
    vertices : (K, 2) north and east (m) of K >= 3 vertices; the last edge leads back to the first.
    """
    edges = np.roll(vertices, -1, axis=0) - vertices
    short = np.flatnonzero(np.hypot(*edges.T) < MIN_LENGTH_M)
    if len(short):
        after = (int(short[0]) + 1) % len(vertices)
        return f"vertices[{short[0]}] and vertices[{after}] are the same position"
    import shapely  # takes a tenth of a second, and only a fence needs it

    polygon = shapely.Polygon(vertices)
    if polygon.is_valid:
        return ""
    place = shapely.Point(*map(float, re.findall(r"[-+.\de]+(?=[ \]])", shapely.is_valid_reason(polygon))))
    lines = shapely.linestrings(np.stack([vertices, vertices + edges], axis=1))
    first, second = sorted(np.argsort(shapely.distance(lines, place), kind="stable")[:2].tolist())
    ends = [f"from vertices[{k}] to vertices[{(k + 1) % len(vertices)}]" for k in (first, second)]
    return f"the ring crosses itself: the edge {ends[0]} meets that {ends[1]}"


def fence_for(vehicle: Vehicle, reference: BaseReference, path: str, notes: list[str] | None = None) -> Fence | None:
    """Read the fence of a mission, or return None for an empty path.

    Parameters
    ----------
    vehicle : a fence needs [hull] in its file.
    reference : has the same origin.
    path, notes : as ``Fence.load`` takes them.

    Raises
    ------
    ConfigError : the file cannot be read, the vehicle has no hull, or the origins differ.
    """
    if not path:
        return None
    hull_radius_m(vehicle)
    fence = Fence.load(path, notes, reference.origin)
    compare_origins(fence, reference, source=f"fence {path}")
    return fence


def compare_origins(fence: Fence | None, reference: BaseReference, *, source: str = "fence") -> None:
    """Compare the origins of a fence and a reference: metres mean the same place only from the same origin.

    Parameters
    ----------
    fence, reference : those without an origin pass.
    source : name of the fence in errors.

    Raises
    ------
    ConfigError : the origins are farther apart than ``MAX_ORIGIN_DISTANCE_M``.
    """
    own, other = None if fence is None else fence.origin, reference.origin
    if own is None or other is None:
        return
    places = ((of.latitude_deg, of.longitude_deg, 0.0) for of in (own, other))
    distance_m = math.dist(*(pymap3d.geodetic2ecef(*place) for place in places))  # through the Earth
    if distance_m > MAX_ORIGIN_DISTANCE_M:
        problem = (
            f"latitude {own.latitude_deg:.6f}, longitude {own.longitude_deg:.6f} is {distance_m:,.1f} m away from the "
            f"origin of the reference, {other.latitude_deg:.6f}, {other.longitude_deg:.6f}: give both the same origin"
        )
        raise ConfigError(source, "[origin]", problem)


def hull_radius_m(vehicle: Vehicle) -> float:
    """Return the radius of the circle around the hull (m).

    Parameters
    ----------
    vehicle : its file needs [hull].

    Raises
    ------
    ConfigError : the vehicle has no hull.
    """
    if vehicle.hull is None:
        raise ConfigError(f"vehicle {vehicle.name}", "[hull]", "is missing: a fence needs length_m and beam_m")
    return vehicle.hull.radius_m
