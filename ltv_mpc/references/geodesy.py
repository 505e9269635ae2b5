"""Where a place is: metres north and east, or latitude and longitude about a stated origin.

Local frame: the plane that touches the WGS 84 ellipsoid at the origin, north and east in it (Groves 2013, Principles of
GNSS, inertial and multisensor integrated navigation systems, eq 2.106, 2.112, 2.150; computed by pymap3d). It is exact,
so its distances differ from those along it by what a plane differs: a point at distance d along the ellipsoid
lies d^3 / (6 R^2) too near, 4 mm at 10 km and 0.5 m at 50 km. North at that point is turned against the origin's by
(l - l0) sin L, 1.6 mrad at 10 km east at 45 degrees.
"""

from __future__ import annotations

import math
from typing import Annotated, TypeAlias

import msgspec
import pymap3d
from msgspec import Meta

from ltv_mpc.messages import Pair

FARTHEST_M = 50_000.0
"""From the origin: farther away the tangent plane is no map of the sea any more."""

Metres: TypeAlias = Annotated[float, Meta(ge=-1e6, le=1e6)]
Latitude: TypeAlias = Annotated[float, Meta(ge=-89, le=89)]
Longitude: TypeAlias = Annotated[float, Meta(ge=-180, le=180)]
Depth: TypeAlias = Annotated[float, Meta(ge=0, le=11_000)]


class Origin(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where north = east = 0 is on WGS 84: the origin of the vehicle's own navigation."""

    latitude_deg: Latitude
    longitude_deg: Longitude


class Place(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """A place in metres, or in degrees about the origin of its file; of a waypoint also its depth."""

    north_m: Metres | None = None
    east_m: Metres | None = None
    latitude_deg: Latitude | None = None
    longitude_deg: Longitude | None = None
    depth_m: Depth | None = None


def local(place: Place, origin: Origin | None) -> Pair:
    """North and east (m) of a place. Raises ``ValueError`` where it is not said, said twice, or too far away."""
    metres, degrees = (place.north_m, place.east_m), (place.latitude_deg, place.longitude_deg)
    if metres[0] is not None and metres[1] is not None and degrees == (None, None):
        return metres[0], metres[1]
    if metres != (None, None) or degrees[0] is None or degrees[1] is None:
        raise ValueError("a place is north_m and east_m, or latitude_deg and longitude_deg")
    if origin is None:
        raise ValueError("latitude_deg and longitude_deg need an [origin] with latitude_deg and longitude_deg")
    north, east = tangent_plane(degrees[0], degrees[1], origin)
    distance = math.hypot(north, east)
    # the far side of the Earth lies near in this projection, so the angle decides first
    if distance > FARTHEST_M or abs(degrees[0] - origin.latitude_deg) > 1.0:
        raise ValueError(
            f"latitude_deg = {degrees[0]:g}, longitude_deg = {degrees[1]:g}: farther than {FARTHEST_M / 1000:g} km "
            "from the origin"
        )
    return north, east


def tangent_plane(latitude_deg: float, longitude_deg: float, origin: Origin) -> Pair:
    """North and east (m) of a point of the ellipsoid, degrees."""
    north, east, _ = pymap3d.geodetic2ned(
        latitude_deg, longitude_deg, 0.0, origin.latitude_deg, origin.longitude_deg, 0.0
    )
    return float(north), float(east)
