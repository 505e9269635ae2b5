"""Geodesy: places in metres north and east, or in latitude and longitude relative to an origin; tables of places.

Local frame: the tangent plane of the WGS 84 ellipsoid at the origin, with its north and east (Groves 2013, Principles
of GNSS, inertial and multisensor integrated navigation systems, eq 2.106, 2.112, 2.150; computed by pymap3d). The
projection is exact, so distances differ from those on the ellipsoid by its curvature alone: a point at distance d along
the ellipsoid is d^3 / (6 R^2) too near, 4 mm at 10 km and 0.5 m at 50 km. Its north is rotated against that of the
origin by (l - l0) sin L, 1.6 mrad at 10 km east at 45 degrees.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, TypeAlias

import msgspec
import pymap3d
from msgspec import Meta

from ltv_mpc.csv_table import Row, read_table
from ltv_mpc.errors import ConfigError, naming
from ltv_mpc.messages import Pair

METRES, DEGREES, DEPTH = ("north_m", "east_m"), ("latitude_deg", "longitude_deg"), "depth_m"
"""Names of the fields of a place, and of the columns of a table."""

MAX_DISTANCE_M = 50_000.0
"""Largest distance from the origin at which the tangent plane is used as a map."""

Metres: TypeAlias = Annotated[float, Meta(ge=-1e6, le=1e6)]
Latitude: TypeAlias = Annotated[float, Meta(ge=-89, le=89)]
Longitude: TypeAlias = Annotated[float, Meta(ge=-180, le=180)]
Depth: TypeAlias = Annotated[float, Meta(ge=0, le=11_000)]


class Origin(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Position of north = east = 0 on WGS 84: the origin of the vehicle's navigation."""

    latitude_deg: Latitude
    longitude_deg: Longitude


class Place(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """Place in metres, or in degrees relative to the origin of the reference; a waypoint may also have a depth."""

    north_m: Metres | None = None
    east_m: Metres | None = None
    latitude_deg: Latitude | None = None
    longitude_deg: Longitude | None = None
    depth_m: Depth | None = None


def local(place: Place, origin: Origin | None) -> Pair:
    """Return north and east (m) of a place.

    Parameters
    ----------
    place : place in metres or in degrees.
    origin : origin of the local frame; None is allowed for a place in metres.

    Raises
    ------
    ValueError
        If the place has no coordinates, has both kinds, or is farther than ``MAX_DISTANCE_M`` from the origin.
    """
    metres, degrees = (place.north_m, place.east_m), (place.latitude_deg, place.longitude_deg)
    if metres[0] is not None and metres[1] is not None and degrees == (None, None):
        return metres[0], metres[1]
    if metres != (None, None) or degrees[0] is None or degrees[1] is None:
        raise ValueError("a position needs north_m and east_m, or latitude_deg and longitude_deg")
    if origin is None:
        raise ValueError("latitude_deg and longitude_deg need an [origin] with latitude_deg and longitude_deg")
    # points on the far side of the Earth project near the origin, so the angles are checked too; NaN is not near
    same_side = abs(origin.latitude_deg) > 80.0 or (degrees[1] - origin.longitude_deg + 90.0) % 360.0 <= 180.0
    near = abs(degrees[0] - origin.latitude_deg) <= 1.0 and same_side
    north, east = tangent_plane(degrees[0], degrees[1], origin) if near else (math.inf, math.inf)
    if math.hypot(north, east) > MAX_DISTANCE_M:
        raise ValueError(
            f"latitude_deg = {degrees[0]:g}, longitude_deg = {degrees[1]:g}: must not be farther than "
            f"{MAX_DISTANCE_M / 1000:g} km from the origin"
        )
    return north, east


def read_places(
    path: Path,
    *columns: str,
    origin: Origin | None,
    rows: tuple[int, int],
    what: str,
    source: str,
    least: Row | None = None,
) -> dict[int, Row]:
    """Return the rows of a CSV table of places by the number of their line; each has ``north_m`` and ``east_m``.

    Parameters
    ----------
    path : the file.
    columns : names of the columns that it must have beside the places; ``depth_m`` is read if there is one.
    origin : position of north = east = 0; None is allowed for a table in metres.
    rows : smallest and largest number of rows.
    what, source, least : as in ``csv_table.read_table``.

    Raises
    ------
    ConfigError
        If the file cannot be read or a row is not valid; with line, column, value and bound.
    """
    kinds = ((*columns, *METRES), (*columns, *DEGREES))
    table = read_table(path, *kinds, what=what, source=source, optional=(DEPTH,), least=least)
    if not rows[0] <= len(table) <= rows[1]:
        problem = f"needs a header and at least {rows[0]} rows of numbers"
        raise ConfigError(source, "", problem if len(table) < rows[0] else f"has {len(table)} rows: at most {rows[1]}")
    for line, row in table.items():
        place = Place(**{name: row.pop(name) for name in (*METRES, *DEGREES) if name in row})
        with naming(source, f"line {line}"):
            row.update(zip(METRES, local(place, origin), strict=True))
    return table


def tangent_plane(latitude_deg: float, longitude_deg: float, origin: Origin) -> Pair:
    """Return north and east (m) in the tangent plane of a point on the ellipsoid.

    Parameters
    ----------
    latitude_deg, longitude_deg : coordinates of the point (degrees).
    origin : point of tangency.
    """
    place, tangency = (latitude_deg, longitude_deg, 0.0), (origin.latitude_deg, origin.longitude_deg, 0.0)
    north, east, _ = pymap3d.geodetic2ned(*place, *tangency)
    return float(north), float(east)
