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
HERE = Origin(latitude_deg=3.0, longitude_deg=4.0)
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


@pytest.mark.parametrize(
    ("place", "origin", "says"),
    [
        (Place(north_m=1.0), None, "a position needs north_m and east_m, or latitude_deg and longitude_deg"),
        (Place(north_m=1, east_m=2, latitude_deg=3, longitude_deg=4), None, "a position needs north_m and east_m, or"),
        (Place(latitude_deg=3.0), HERE, "position needs north_m and east_m, or"),
        (Place(latitude_deg=3.0, longitude_deg=4.0), None, r"need an \[origin\]"),
        (Place(latitude_deg=3.6, longitude_deg=4.0), HERE, "farther than 50 km"),
        (Place(latitude_deg=-3.0, longitude_deg=-176.0), HERE, "farther than"),
        (Place(latitude_deg=0.1, longitude_deg=-80.0), Origin(latitude_deg=0.1, longitude_deg=100.0), "farther than"),
    ],
)
def test_a_place_without_coordinates_with_both_kinds_or_too_far_is_rejected(place, origin, says):
    with pytest.raises(ValueError, match=says):
        local(place, origin)


def test_metres_are_returned_unchanged():
    assert local(Place(north_m=-1.5, east_m=2.5), None) == (-1.5, 2.5)
    np.testing.assert_allclose(local(Place(latitude_deg=3.0, longitude_deg=4.0), HERE), 0.0, atol=1e-6)
