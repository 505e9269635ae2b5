"""Half-planes along a track: which rows a point has, and what they ask for."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given

from ltv_mpc.geofence.fence import Fence
from ltv_mpc.geofence.half_planes import ROWS, HalfPlanes, half_planes
from ltv_mpc.geofence.zones import Zones, nearest, pack_zones
from ltv_mpc.messages import Array, Pair
from tests.ltv_mpc.geofence.shapes import boundary_distance, contains, disc, fence_of, point, polygon, rings

SQUARE = np.array([[0.0, 0.0], [0.0, 10.0], [10.0, 10.0], [10.0, 0.0]])
NOTCH = np.array([[0.0, 0.0], [0.0, 10.0], [10.0, 10.0], [10.0, 6.0], [4.0, 6.0], [4.0, 4.0], [10.0, 4.0], [10.0, 0.0]])


def rows_of(zones: Zones, at: Array, need: float = 1.0, reach: float = 100.0, exits: Array | None = None) -> HalfPlanes:
    points, Z = np.atleast_2d(at).astype(float), len(zones.radius)
    required, near = np.full((len(points), Z), need), np.full(len(points), reach)
    return half_planes(zones, points, required, np.zeros((Z, 4)) if exits is None else exits, near)


@given(rings(), point)
def test_the_first_row_of_a_point_is_that_of_the_nearest_boundary(ring: Array, at: tuple[float, float]) -> None:
    zones = pack_zones(fence_of(ring, keep_in=False))
    distance = nearest(zones, 0, *at)[0]
    assume(abs(distance) > 1e-6)
    rows = rows_of(zones, np.array(at), reach=max(distance - 1.0, 0.0) + 0.5)  # hardly enough
    assert rows.zone[0, 0] == 0
    assert rows.slack[0, 0] == pytest.approx(distance - 1.0, abs=1e-9)
    assert np.hypot(*rows.normal[0, 0]) == pytest.approx(1.0)
    used = rows.zone[0] >= 0
    assert np.all(np.diff(rows.slack[0, used]) >= 0.0)
    np.testing.assert_allclose(rows.normal[0, used] @ at - rows.offset[0, used], rows.slack[0, used], atol=1e-9)


@given(rings(), point, point)
def test_a_point_that_keeps_the_row_of_a_convex_zone_is_clear_of_it(ring: Array, at: Pair, moved: Pair) -> None:
    hull = np.array([p for p in ring if np.hypot(*(p - ring[0])) < 40.0])[:3]  # a triangle of the ring's vertices
    assume(abs(np.linalg.det(hull[1:] - hull[0])) > 1e-3)
    zones = pack_zones(fence_of(hull, keep_in=False))
    assume(nearest(zones, 0, *at)[0] > 1e-6)
    rows = rows_of(zones, np.array(at))
    assert rows.zone[0].tolist() == [0, -1, -1]  # a convex zone has one nearest point
    if rows.normal[0, 0] @ moved >= rows.offset[0, 0]:
        assert not contains(hull, np.array(moved))
        assert boundary_distance(hull, np.array(moved)) >= 1.0 - 1e-9


def test_inside_a_corner_of_a_keep_in_zone_both_edges_have_rows() -> None:
    zones = pack_zones(fence_of(SQUARE, keep_in=True))
    rows = rows_of(zones, np.array([2.0, 1.5]), reach=3.0)
    assert rows.zone[0].tolist() == [0, 0, -1]
    np.testing.assert_allclose(rows.slack[0, :2], [0.5, 1.0])
    np.testing.assert_allclose(rows.normal[0, :2], [[0.0, 1.0], [1.0, 0.0]], atol=1e-12)
    np.testing.assert_allclose(rows.offset[0, :2], [1.0, 1.0])


def test_in_a_notch_all_its_three_walls_have_rows() -> None:
    zones = pack_zones(fence_of(NOTCH, keep_in=False))
    rows = rows_of(zones, np.array([4.8, 4.9]), need=0.2)
    assert rows.zone[0].tolist() == [0, 0, 0]
    np.testing.assert_allclose(rows.slack[0], [0.6, 0.7, 0.9])


def test_the_nearest_of_many_zones_are_taken() -> None:
    zones = pack_zones(Fence(margin_m=0.0, keep_out_disc=tuple(disc(n, 0.0, 1.0) for n in (20.0, 5.0, 40.0, 10.0))))
    rows = rows_of(zones, np.zeros(2), need=0.5)
    assert rows.zone[0].tolist() == [1, 3, 0]
    np.testing.assert_allclose(rows.slack[0], [3.5, 8.5, 18.5])
    assert rows_of(zones, np.zeros(2), reach=4.0).zone[0].tolist() == [1, -1, -1]


def test_a_point_inside_is_pushed_to_the_nearest_boundary() -> None:
    zones = pack_zones(Fence(margin_m=0.0, keep_out=(polygon(SQUARE),)))
    rows = rows_of(zones, np.array([[5.0, 1.0], [5.0, -2.0]]))
    np.testing.assert_allclose(rows.normal[:, 0], [[0.0, -1.0], [0.0, -1.0]], atol=1e-12)
    np.testing.assert_allclose(rows.offset[:, 0], [1.0, 1.0])
    np.testing.assert_allclose(rows.slack[:, 0], [-2.0, 1.0])


def test_an_exit_is_asked_of_all_points_however_far() -> None:
    zones = pack_zones(Fence(margin_m=0.0, keep_out=(polygon(SQUARE),)))
    rows = rows_of(zones, np.array([[5.0, 1.0], [500.0, 2.0]]), reach=1.0, exits=np.array([[1.0, 0.6, 0.8, 10.0]]))
    np.testing.assert_allclose(rows.normal[:, 0], [[0.6, 0.8]] * 2)
    np.testing.assert_allclose(rows.offset[:, 0], 11.0)
    np.testing.assert_allclose(rows.slack[:, 0], [3.8 - 11.0, 301.6 - 11.0])


def test_a_point_out_of_reach_has_no_row() -> None:
    zones = pack_zones(Fence(margin_m=0.0, keep_out_disc=(disc(5.0, 0.0, 1.0),)))
    rows = rows_of(zones, np.full(2, 900.0), reach=1.0)
    assert rows.zone.tolist() == [[-1] * ROWS]
