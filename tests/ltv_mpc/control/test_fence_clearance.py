"""Clearances along a track: those that are skipped change nothing."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.control.fencing import ACTIVE_M, clearance_table, entry_s
from ltv_mpc.control.ocp.fence import PENALTY, Scene, fence_cost, surplus_m
from ltv_mpc.control.problem_data import Constants
from ltv_mpc.control.resolution import settled
from ltv_mpc.geofence.zones import Zones, clearances, pack_zones
from ltv_mpc.messages import Array
from tests.ltv_mpc.control.fence_scenes import WALLS, scene
from tests.ltv_mpc.control.problems import PAPER
from tests.ltv_mpc.geofence.shapes import polygon

KNOTS = np.concatenate([np.arange(20.0), 19.0 + 2.5 * np.arange(1.0, 9.0)])
TIMES_S = 0.3 * KNOTS
HULL_M = 0.3
WIDE = msgspec.structs.replace(
    WALLS, keep_in=(polygon(np.array([[-20.0, -20.0], [-20.0, 20.0], [20.0, 20.0], [20.0, -20.0]])),)
)
SEEDS = range(20)


def track(seed: int) -> Array:
    """Return states (K, 8) on a smooth track among the zones, with sag of its chords."""
    rng = np.random.default_rng(seed)
    heading = rng.uniform(-math.pi, math.pi) + np.cumsum(rng.normal(0.0, 0.15, len(KNOTS)))
    lengths = rng.uniform(0.2, 0.5) * np.diff(KNOTS, prepend=0.0)
    X = np.zeros((len(KNOTS), 8))
    X[:, 0] = rng.uniform(-2.0, 4.0) + np.cumsum(lengths * np.cos(heading))
    X[:, 1] = rng.uniform(-2.0, 3.0) + np.cumsum(lengths * np.sin(heading))
    X[:, 2], X[:, 5] = 0.5, 0.4
    return X


def every_clearance(of: Scene, points: Array, t_s: Array) -> Array:
    """Return the clearance (P, Z + O) of each point from each zone and obstacle, without the growth of an obstacle."""
    disc = of.discs[0]
    away = np.hypot(*(points - disc[:2] - t_s[:, None] * disc[2:4]).T) - disc[4]
    return np.column_stack([clearances(of.zones, points), away])


def every_need(of: Scene, t_s: Array) -> Array:
    """Return the required clearance (P, Z + O) at each time."""
    disc = of.discs[0]
    sd = np.hypot(math.sqrt(disc[5]), 0.05 * (disc[6] + t_s))
    return np.column_stack([np.tile(of.need, (len(t_s), 1)), 3.0 * sd + of.disc_need_m[0]])


@pytest.mark.parametrize("seed", SEEDS)
def test_the_cost_of_a_track_is_that_of_all_its_points(seed: int) -> None:
    of, X = scene(), track(seed)
    o = Constants.of(PAPER, settled(ControllerConfig(), PAPER).weights, KNOTS)
    total = 0.0
    for k, g in enumerate(np.diff(KNOTS), 1):
        part = np.arange(1, math.ceil(g) + 1) / math.ceil(g)
        points = X[k - 1, :2] + part[:, None] * (X[k, :2] - X[k - 1, :2])
        t_s = 0.3 * (KNOTS[k - 1] + part * g)
        lack = np.maximum(every_need(of, t_s) - every_clearance(of, points, t_s), 0.0)
        lack[:-1] += np.where(lack[:-1] > 0.0, 0.5 * 0.4 * (0.3 * g) ** 2 / 8.0, 0.0)
        total += PENALTY * g * lack.max(axis=0).sum()
    assert fence_cost(X, of, o.t, o.state_scale[0]) == pytest.approx(total)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_first_entry_is_that_of_all_its_points(seed: int) -> None:
    of, X = scene(), track(seed)
    free = every_clearance(of, X[:, :2], TIMES_S) - HULL_M
    first = math.inf
    for row in free.T:
        k = int(np.argmax(row < 0.0))
        if row[k] < 0.0:
            first = min(first, 0.0 if k == 0 else np.interp(0.0, row[[k, k - 1]], TIMES_S[[k, k - 1]]))
    assert entry_s(X, TIMES_S, of, HULL_M) == pytest.approx(first)
    assert clearance_table(X, TIMES_S, of, HULL_M)[1] == pytest.approx(first)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_table_has_the_least_of_all_its_points(seed: int) -> None:
    of, X = scene(), track(seed)
    if seed % 2:  # most zones are not active
        of = scene(zones=pack_zones(WIDE), need=0.1 * of.need, disc_need_m=0.1 * of.disc_need_m)
    table, _ = clearance_table(X, TIMES_S, of, HULL_M)
    free = every_clearance(of, X[:, :2], TIMES_S)
    surplus = free - every_need(of, TIMES_S)
    least = free.min(axis=0)
    assert table[:, 0].min() == pytest.approx(least.min())
    assert table[:, 0].argmin() == least.argmin()
    near = surplus.min(axis=0) < ACTIVE_M
    np.testing.assert_array_equal(table[:, 2] < ACTIVE_M, near)
    np.testing.assert_allclose(table[near, 1], free[0, near])
    np.testing.assert_allclose(table[near, 2], surplus.min(axis=0)[near])
    np.testing.assert_array_equal(table[:, 3], (surplus < -0.01).sum(axis=0))


def test_in_a_zone_the_surplus_is_that_over_the_half_plane_of_its_exit() -> None:
    exits = np.zeros((3, 4))
    exits[1] = 1.0, 0.8, -0.6, 2.0
    of = scene(exits=exits)
    for north_m, east_m in np.random.default_rng(0).uniform(-3.0, 3.0, (10, 2)):
        beyond_m = 0.8 * north_m - 0.6 * east_m - 2.0 - of.need[1]
        assert surplus_m(of, 1, north_m, east_m, 0.0) == pytest.approx(beyond_m)


def test_a_place_far_to_the_south_west_changes_nothing() -> None:
    of, far = scene(), np.array([-70.0, -50.0])
    zones, discs = of.zones, of.discs.copy()
    discs[:, :2] += far
    circle = zones.circle + np.array([*far, 0.0])
    moved = scene(zones=Zones(zones.vertices + far, zones.first, zones.radius, zones.margin, circle), discs=discs)
    o = Constants.of(PAPER, settled(ControllerConfig(), PAPER).weights, KNOTS)
    for seed in SEEDS:
        X, away = track(seed), track(seed)
        away[:, :2] += far
        assert fence_cost(away, moved, o.t, o.state_scale[0]) == pytest.approx(fence_cost(X, of, o.t, o.state_scale[0]))
        assert entry_s(away, TIMES_S, moved, HULL_M) == pytest.approx(entry_s(X, TIMES_S, of, HULL_M))
