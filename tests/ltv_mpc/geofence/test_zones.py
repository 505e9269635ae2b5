"""Signed distance to zones, against a distance and a point-in-polygon test of others."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given

from ltv_mpc.geofence.fence import Fence
from ltv_mpc.geofence.zones import are_clear, clearances, nearest, pack_zones
from ltv_mpc.messages import Array, Pair
from tests.ltv_mpc.geofence.shapes import boundary_distance, contains, disc, fence_of, point, rings


@given(rings(), point)
def test_the_clearance_is_the_distance_to_the_ring_with_the_sign_of_its_side(ring: Array, at: Pair) -> None:
    distance = boundary_distance(ring, np.array(at))
    assume(distance > 1e-6)
    inside = contains(ring, np.array(at))
    out, into = (nearest(pack_zones(fence_of(ring, keep_in=side)), 0, *at)[0] for side in (False, True))
    assert out == pytest.approx(-distance if inside else distance, abs=1e-9)
    assert into == pytest.approx(-out, abs=1e-9)


@given(rings(), point)
def test_the_normal_leads_from_the_boundary_to_the_point_or_out_of_the_zone(ring: Array, at: Pair) -> None:
    distance, mn, me, qn, qe = nearest(pack_zones(fence_of(ring, keep_in=False)), 0, *at)
    assert np.hypot(mn, me) == pytest.approx(1.0)
    np.testing.assert_allclose([qn + distance * mn, qe + distance * me], at, atol=1e-9)
    assert boundary_distance(ring, np.array([qn, qe])) < 1e-9


@given(point, point)
def test_a_disc_is_its_centre_with_a_radius(centre: tuple[float, float], at: tuple[float, float]) -> None:
    zones = pack_zones(Fence(margin_m=0.0, keep_out_disc=(disc(*centre, 4.0),)))
    distance, mn, me, qn, qe = nearest(zones, 0, *at)
    assert distance == pytest.approx(np.hypot(at[0] - centre[0], at[1] - centre[1]) - 4.0)
    assert np.hypot(qn - centre[0], qe - centre[1]) == pytest.approx(4.0)
    assert np.hypot(mn, me) == pytest.approx(1.0)


@given(rings())
def test_the_circle_is_around_the_whole_zone(ring: Array) -> None:
    zones = pack_zones(fence_of(ring, keep_in=False))
    assert np.hypot(*(ring - zones.circle[0, :2]).T).max() <= zones.circle[0, 2] + 1e-9


@given(rings(), rings())
def test_points_are_clear_where_all_clearances_are_large_enough(around: Array, ring: Array) -> None:
    keep_in, keep_out = fence_of(around, keep_in=True).keep_in, fence_of(ring, keep_in=False).keep_out
    zones = pack_zones(Fence(margin_m=1.0, keep_in=keep_in, keep_out=keep_out, keep_out_disc=(disc(5.0, 5.0, 4.0),)))
    need, points = np.array([0.5, 2.0, 1.0]), np.random.default_rng(2).uniform(-40.0, 40.0, (300, 2))
    np.testing.assert_array_equal(are_clear(zones, need, points), (clearances(zones, points) >= need).all(axis=1))


def test_zones_keep_the_order_of_the_fence_and_their_margins() -> None:
    ring = np.array([[0.0, 0.0], [0.0, 50.0], [50.0, 50.0]])
    keep_in = fence_of(ring, keep_in=True).keep_in
    zones = pack_zones(Fence(margin_m=2.0, keep_in=keep_in, keep_out_disc=(disc(1.0, 2.0, 3.0),)))
    assert zones.first.tolist() == [0, 3, 4]
    assert zones.radius.tolist() == [0.0, 3.0]
    assert zones.margin.tolist() == [2.0, 2.0]
    assert np.isinf(zones.circle[0, 2])


def test_the_middle_of_a_disc_has_a_normal() -> None:
    zones = pack_zones(Fence(margin_m=0.0, keep_out_disc=(disc(0.0, 0.0, 1.0), disc(9.0, 5.0, 2.0))))
    assert nearest(zones, 1, 9.0, 5.0) == (-2.0, 1.0, 0.0, 11.0, 5.0)
