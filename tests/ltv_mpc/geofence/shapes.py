"""Random zones, and their distances by shapely."""

from __future__ import annotations

import numpy as np
import shapely
from hypothesis import strategies as st

from ltv_mpc.geofence.fence import Disc, Fence, Polygon
from ltv_mpc.messages import Array
from ltv_mpc.references.geodesy import Place

coordinate = st.floats(-30.0, 30.0)
point = st.tuples(coordinate, coordinate)


@st.composite
def rings(draw: st.DrawFn) -> Array:
    """Draw a star-shaped ring, convex or concave, in either orientation."""
    count = draw(st.integers(3, 9))
    radius = np.array(draw(st.lists(st.floats(1.0, 20.0), min_size=count, max_size=count)))
    share = np.array(draw(st.lists(st.floats(-0.3, 0.3), min_size=count, max_size=count)))
    angle = 2.0 * np.pi * (np.arange(count) + share) / count
    ring = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)]) + np.array(draw(point))
    return ring[::-1].copy() if draw(st.booleans()) else ring


def polygon(ring: Array, margin_m: float | None = None) -> Polygon:
    places = tuple(Place(north_m=float(n), east_m=float(e)) for n, e in ring)
    return Polygon(vertices=places, margin_m=margin_m)


def disc(north_m: float, east_m: float, radius_m: float) -> Disc:
    return Disc(centre=Place(north_m=north_m, east_m=east_m), radius_m=radius_m)


def fence_of(ring: Array, *, keep_in: bool) -> Fence:
    if keep_in:
        return Fence(margin_m=1.0, keep_in=(polygon(ring),))
    return Fence(margin_m=1.0, keep_out=(polygon(ring),))


def boundary_distance(ring: Array, at: Array) -> float:
    return float(shapely.LinearRing(ring).distance(shapely.Point(at)))


def contains(ring: Array, at: Array) -> bool:
    return bool(shapely.Polygon(ring).contains(shapely.Point(at)))
