"""Where a place is: metres north and east, or latitude and longitude about a stated origin.

Local frame: the plane that touches the WGS 84 ellipsoid at the origin, north and east in it. With the prime vertical
radius of curvature R_E = a / sqrt(1 - e^2 sin^2 L), a point of the ellipsoid at latitude L and longitude l has

    ECEF  r = R_E [cos L cos l, cos L sin l, (1 - e^2) sin L]
    north = [-sin L0 cos l0, -sin L0 sin l0, cos L0] . (r - r0)
    east  = [-sin l0, cos l0, 0] . (r - r0)

Exact, so what it differs by from distances on the ellipsoid is the plane's own: a point at distance d along the
ellipsoid lies d^3 / (6 R^2) too near, 4 mm at 10 km and 0.5 m at 50 km; and north there is turned against the origin's
by (l - l0) sin L, 1.6 mrad at 10 km east at 45 degrees.

Source: Groves 2013, Principles of GNSS, inertial and multisensor integrated navigation systems, eq 2.106, 2.112, 2.150.
"""

from __future__ import annotations

import math
from typing import Annotated, TypeAlias

import msgspec
from msgspec import Meta

from ltv_mpc.messages import Pair

EQUATORIAL_RADIUS_M = 6_378_137.0
"""a of WGS 84."""
FLATTENING = 1.0 / 298.257223563
"""f of WGS 84; e^2 = f (2 - f)."""
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
    r, r0 = _ecef(latitude_deg, longitude_deg), _ecef(origin.latitude_deg, origin.longitude_deg)
    x, y, z = r[0] - r0[0], r[1] - r0[1], r[2] - r0[2]
    L, l = math.radians(origin.latitude_deg), math.radians(origin.longitude_deg)  # noqa: E741
    north = -math.sin(L) * (math.cos(l) * x + math.sin(l) * y) + math.cos(L) * z
    east = -math.sin(l) * x + math.cos(l) * y
    return north, east


def _ecef(latitude_deg: float, longitude_deg: float) -> tuple[float, float, float]:
    L, l = math.radians(latitude_deg), math.radians(longitude_deg)  # noqa: E741
    e2 = FLATTENING * (2.0 - FLATTENING)
    R_E = EQUATORIAL_RADIUS_M / math.sqrt(1.0 - e2 * math.sin(L) ** 2)
    return R_E * math.cos(L) * math.cos(l), R_E * math.cos(L) * math.sin(l), R_E * (1.0 - e2) * math.sin(L)
