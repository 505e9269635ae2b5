"""Geodesy: latitude and longitude relative to an origin, against the ellipsoid."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ltv_mpc.references.geodesy import Origin, Place, local, tangent_plane

EQUATORIAL_RADIUS_M = 6_378_137.0
FLATTENING = 1.0 / 298.257223563  # of WGS 84
E2 = FLATTENING * (2.0 - FLATTENING)


def metres_a_degree(latitude_deg: float) -> tuple[float, float]:
    """North and east from the two radii of curvature, by another formula than the one tested."""
    w = 1.0 - E2 * math.sin(math.radians(latitude_deg)) ** 2
    meridian = EQUATORIAL_RADIUS_M * (1.0 - E2) / w**1.5
    transverse = EQUATORIAL_RADIUS_M / math.sqrt(w)
    return math.radians(meridian), math.radians(transverse * math.cos(math.radians(latitude_deg)))


@given(st.floats(-80, 80), st.floats(-180, 180), st.floats(-1e-3, 1e-3), st.floats(-1e-3, 1e-3))
def test_near_the_origin_positions_agree_with_the_radii_of_curvature(latitude, longitude, north_deg, east_deg):
    north, east = tangent_plane(
        latitude + north_deg, longitude + east_deg, Origin(latitude_deg=latitude, longitude_deg=longitude)
    )
    a_degree = metres_a_degree(latitude)
    assert north == pytest.approx(north_deg * a_degree[0], abs=0.02)
    assert east == pytest.approx(east_deg * a_degree[1], abs=0.02)


def test_a_known_degree():
    """The first degree of latitude from the equator is 110 574 m long, of longitude 111 320 m (WGS 84)."""
    equator = Origin(latitude_deg=0.0, longitude_deg=10.0)
    north, east = tangent_plane(0.1, 10.1, equator)
    assert north == pytest.approx(11_057.4, abs=0.1)
    assert east == pytest.approx(11_131.9, abs=0.1)


@pytest.mark.parametrize("bearing", [0.0, 0.7, 2.0])
def test_at_10_km_the_plane_is_millimetres_short_of_the_ellipsoid(bearing):
    """The difference is d^3 / (6 R^2) = 4 mm."""
    origin = Origin(latitude_deg=50.0, longitude_deg=-5.0)
    a_degree = metres_a_degree(50.0)
    steps = 2000  # along the ellipsoid in short steps, each by the radii of curvature where it begins
    latitude, longitude, course = 50.0, -5.0, bearing
    for _ in range(steps):
        middle = latitude + 0.5 * 10_000.0 / steps * math.cos(course) / a_degree[0]
        per_north, per_east = metres_a_degree(middle)
        latitude += 10_000.0 / steps * math.cos(course) / per_north
        d_longitude = 10_000.0 / steps * math.sin(course) / per_east
        longitude += d_longitude
        course += math.radians(d_longitude) * math.sin(math.radians(middle))  # a geodesic turns with the meridians
    assert math.hypot(*tangent_plane(latitude, longitude, origin)) == pytest.approx(10_000.0 - 0.0041, abs=0.002)


@pytest.mark.parametrize(
    ("place", "origin", "says"),
    [
        (Place(north_m=1.0), None, "a position needs north_m and east_m, or latitude_deg and longitude_deg"),
        (
            Place(north_m=1.0, east_m=2.0, latitude_deg=3.0, longitude_deg=4.0),
            None,
            "a position needs north_m and east_m, or",
        ),
        (Place(latitude_deg=3.0), Origin(latitude_deg=3.0, longitude_deg=4.0), "position needs north_m and east_m, or"),
        (Place(latitude_deg=3.0, longitude_deg=4.0), None, r"need an \[origin\]"),
        (Place(latitude_deg=3.6, longitude_deg=4.0), Origin(latitude_deg=3.0, longitude_deg=4.0), "farther than 50 km"),
        (Place(latitude_deg=-3.0, longitude_deg=-176.0), Origin(latitude_deg=3.0, longitude_deg=4.0), "farther than"),
    ],
)
def test_a_place_without_coordinates_with_both_kinds_or_too_far_is_rejected(place, origin, says):
    with pytest.raises(ValueError, match=says):
        local(place, origin)


def test_metres_are_returned_unchanged():
    assert local(Place(north_m=-1.5, east_m=2.5), None) == (-1.5, 2.5)
    np.testing.assert_allclose(
        local(Place(latitude_deg=3.0, longitude_deg=4.0), Origin(latitude_deg=3.0, longitude_deg=4.0)), 0.0, atol=1e-6
    )
