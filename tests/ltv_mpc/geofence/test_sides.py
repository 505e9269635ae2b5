"""Sides of zones: chosen once, kept, changed with patience; exits that stay until the vehicle is out."""

from __future__ import annotations

import numpy as np

from ltv_mpc.geofence.fence import Fence
from ltv_mpc.geofence.half_planes import ALL, INSIDE, NONE
from ltv_mpc.geofence.sides import PATIENCE_NS, SideMemory
from ltv_mpc.geofence.zones import pack_zones
from tests.ltv_mpc.geofence.shapes import disc, fence_of, polygon

NORTHWARD = np.column_stack([np.linspace(-5.0, 5.0, 21), np.full(21, 0.3)])
SQUARE = np.array([[-2.0, -2.0], [-2.0, 2.0], [2.0, 2.0], [2.0, -2.0]])


def memory() -> SideMemory:
    return SideMemory(pack_zones(Fence(margin_m=0.0, keep_out_disc=(disc(0.0, 0.0, 2.0),))))


def test_the_first_side_is_the_one_with_the_shorter_way() -> None:
    """North past a disc whose centre lies to port: the way to starboard, east, is shorter."""
    sides, other = memory(), memory()
    sides.update((-6.0, 0.3), NORTHWARD)
    assert sides.side.tolist() == [1]
    np.testing.assert_allclose(sides.pushes[0], [INSIDE, 0.0, 1.0, 2.0], atol=1e-12)
    other.update((-6.0, -0.3), NORTHWARD * [1.0, -1.0])
    assert other.side.tolist() == [-1]
    np.testing.assert_allclose(other.pushes[0], [INSIDE, 0.0, -1.0, 2.0], atol=1e-12)


def test_a_side_is_kept_while_the_track_crosses_the_zone_whatever_half_of_it() -> None:
    sides = memory()
    sides.update((-6.0, 0.3), NORTHWARD)
    sides.update((-6.0, -0.3), NORTHWARD * [1.0, -1.0])
    assert sides.side.tolist() == [1]
    sides.update((-6.0, -0.3), NORTHWARD - [20.0, 0.0])
    assert sides.side.tolist() == [0]
    assert sides.pushes[0, 0] == NONE


def test_another_side_must_be_cheaper_by_a_share_and_for_a_time() -> None:
    sides, step = memory(), PATIENCE_NS // 4
    sides.update((-6.0, 0.3), NORTHWARD)
    assert not any(sides.consider(0, 1.0, 0.96, k * step) for k in range(20))
    assert not any(sides.consider(0, 1.0, 0.9, k * step) for k in range(4))
    assert not sides.consider(0, 1.0, 1.0, 4 * step)
    assert not any(sides.consider(0, 1.0, 0.9, k * step) for k in range(5, 9))
    assert sides.consider(0, 1.0, 0.9, 9 * step)
    sides.update((-6.0, 0.3), NORTHWARD)
    np.testing.assert_allclose(sides.pushes[0], [INSIDE, 0.0, -1.0, 2.0], atol=1e-12)


def test_an_exit_is_fixed_until_the_vehicle_is_out() -> None:
    """It enters near the east side and drifts west past the middle, where a free choice would turn round."""
    sides = SideMemory(pack_zones(Fence(margin_m=0.0, keep_out=(polygon(SQUARE),))))
    for east_m in (1.5, 0.0, -1.5):
        sides.update((0.0, east_m), NORTHWARD)
        np.testing.assert_allclose(sides.pushes[0], [ALL, 0.0, 1.0, 2.0], atol=1e-12)
    sides.update((0.0, -2.5), NORTHWARD - [20.0, 0.0])
    assert sides.pushes[0, 0] == NONE
    sides.update((0.0, -1.5), NORTHWARD)
    np.testing.assert_allclose(sides.pushes[0], [ALL, 0.0, -1.0, 2.0], atol=1e-12)


def test_a_keep_in_zone_has_no_sides() -> None:
    sides = SideMemory(pack_zones(fence_of(SQUARE, keep_in=True)))
    sides.update((0.0, 0.0), NORTHWARD)
    assert sides.side.tolist() == [0]
    assert sides.pushes[0, 0] == NONE
