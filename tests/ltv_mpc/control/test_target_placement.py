"""Targets round the zones and out of reach: where they are, and how fast they move."""

from __future__ import annotations

import numpy as np
import pytest

from ltv_mpc.control.lateral import bring_within
from ltv_mpc.control.scaling import Scales
from ltv_mpc.control.target_placement import FAR, LEAD, MIN_SPEED, bring_near, lead_round
from ltv_mpc.geofence.fence import Disc, Fence
from ltv_mpc.geofence.route import Router
from ltv_mpc.geofence.zones import pack_zones
from ltv_mpc.messages import Array
from ltv_mpc.references import Place

SCALES = Scales(speed_mps=0.8, time_s=10.0)
TIMES_S = np.arange(31.0)
START = np.array([-3.0, 4.0])
STILL = np.zeros(2)
FAR_AWAY = Fence(margin_m=0.0, keep_out_disc=(Disc(centre=Place(north_m=900.0, east_m=900.0), radius_m=1.0),))


def router(*discs: tuple[float, float, float]) -> Router:
    zones = tuple(Disc(centre=Place(north_m=n, east_m=e), radius_m=radius) for n, e, radius in discs)
    fence = Fence(margin_m=0.0, keep_out_disc=zones) if discs else FAR_AWAY
    return Router(pack_zones(fence), np.ones(max(len(discs), 1)))


def targets(*places: tuple[float, float]) -> Array:
    """Return the targets of a horizon at rest at places, each for an equal part of it; the last row is a velocity."""
    table = np.zeros((len(TIMES_S), 3))
    table[:-1, :2] = np.array(places)[np.arange(len(TIMES_S) - 1) * len(places) // (len(TIMES_S) - 1)]
    return table


@pytest.mark.parametrize("water", [(0.0, 0.0), (0.3, 0.0), (-0.2, 0.1)], ids=str)
def test_targets_run_ahead_at_the_speed_that_the_vehicle_reaches_over_ground(water: tuple[float, float]) -> None:
    """Largest s with |s e - c| = V, by a fine search along the line."""
    goal = np.array([57.0, 84.0])
    along = (goal - START) / 100.0
    speeds = np.linspace(0.0, 2.0, 200_001)
    through_water = np.hypot(speeds * along[0] - water[0], speeds * along[1] - water[1])
    speed = float(speeds[through_water <= SCALES.speed_mps].max())
    table = targets((57.0, 84.0))
    assert lead_round(router(), START, np.array(water), table, TIMES_S, SCALES) is True
    way = (table[:-1, :2] - START) @ along
    np.testing.assert_allclose(way, speed * TIMES_S[1:] + LEAD * SCALES.length_m, atol=1e-3)
    np.testing.assert_allclose(table[:-1, :2], START + way[:, None] * along, atol=1e-9)
    np.testing.assert_allclose(table[-1, :2], speed * along, atol=1e-4)


def test_a_current_that_is_too_strong_leaves_a_smallest_speed() -> None:
    table = targets((-3.0, 104.0))
    lead_round(router(), START, np.array([0.0, -1.5]), table, TIMES_S, SCALES)
    np.testing.assert_allclose(table[-1, :2], [0.0, MIN_SPEED * SCALES.speed_mps])
    here = targets((-3.0, 4.0))
    assert lead_round(router(), START, STILL, here, TIMES_S, SCALES)
    np.testing.assert_array_equal(here[:-1, :2], np.tile(START, (30, 1)))


def test_targets_behind_a_zone_lead_round_it_and_in_their_order() -> None:
    of = router((-3.0, 12.0, 3.0))
    table = targets((-3.0, 20.0), (5.0, 20.0), (5.0, 12.0))
    assert lead_round(of, START, STILL, table, TIMES_S, SCALES)
    way = table[:-1, :2]
    assert not of.chain_is_blocked(START, way)
    steps = np.hypot(*np.diff(np.vstack([START, way]), axis=0).T)
    assert steps[1:].max() < 1.001 * SCALES.speed_mps
    first, second = (np.hypot(*(way - place).T) for place in ((-3.0, 20.0), (5.0, 20.0)))
    assert first.min() < 0.5 * SCALES.speed_mps
    assert first.argmin() < second.argmin()
    assert (way[-1] != (5.0, 12.0)).any()  # on the way to the third place
    np.testing.assert_allclose(table[-1, :2], [0.0, -SCALES.speed_mps], atol=1e-9)
    np.testing.assert_allclose(table[-1, :2], (way[-1] - way[-2]) / (TIMES_S[-1] - TIMES_S[-2]), atol=1e-9)
    later = targets((-3.0, 20.0), (5.0, 20.0), (5.0, 12.0))
    assert lead_round(of, START, STILL, later, 3.0 * TIMES_S, SCALES)
    np.testing.assert_array_equal(later[-2:], [[5.0, 12.0, 0.0], [0.0, 0.0, 0.0]])


def test_a_target_out_of_reach_is_brought_nearer_in_its_direction() -> None:
    table, water = targets((297.0, 404.0), (-3.0, 5.0), (-303.0, -396.0)), np.array([0.3, -0.4])
    before = table.copy()
    bring_near(START, water, table, 20.0, 0.8)
    reach_m = FAR * 20.0 * (0.8 + 0.5)
    np.testing.assert_allclose(table[:10, :2] - START, np.tile([0.6 * reach_m, 0.8 * reach_m], (10, 1)))
    np.testing.assert_array_equal(table[10:20], before[10:20])
    np.testing.assert_allclose(table[20:30, :2] - START, np.tile([-0.6 * reach_m, -0.8 * reach_m], (10, 1)))
    np.testing.assert_array_equal(table[-1], before[-1])


def test_with_a_tolerance_a_target_is_the_point_of_its_disc_nearest_to_the_vehicle() -> None:
    table = targets((12.0, 20.0), (13.0, 26.0), (10.0, 18.5))
    last = table[-1].copy()
    bring_within(np.array([10.0, 19.0]), 2.0, table)
    np.testing.assert_allclose(table[:10, :2], np.tile([12.0 - 4.0 / 5**0.5, 20.0 - 2.0 / 5**0.5], (10, 1)))
    off = np.array([-3.0, -7.0])
    np.testing.assert_allclose(table[10:20, :2], np.tile([13.0, 26.0] + 2.0 * off / np.hypot(*off), (10, 1)))
    np.testing.assert_allclose(table[20:30, :2], np.tile([10.0, 19.0], (10, 1)))  # within: where it is
    np.testing.assert_array_equal(table[-1], last)
