"""Shortest ways round the zones: they keep the clearance, are the shortest, and stay on their side."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from ltv_mpc.geofence.fence import Fence, Polygon
from ltv_mpc.geofence.route import SLACK_M, Router
from ltv_mpc.geofence.zones import Zones, clearances, pack_zones
from ltv_mpc.messages import Array, Pair
from tests.ltv_mpc.geofence import shapes
from tests.ltv_mpc.geofence.shapes import disc, point, rings


def polygon(*corners: tuple[float, float]) -> Polygon:
    return shapes.polygon(np.array(corners))


def along(start: Array, way: Array) -> Array:
    """Points of a way, 5 cm apart."""
    corners = np.vstack([start, way])
    legs = [np.linspace(a, b, 2 + int(math.dist(a, b) / 0.05)) for a, b in itertools.pairwise(corners)]
    return np.vstack(legs)


def length(start: Array, way: Array) -> float:
    return float(np.hypot(*np.diff(np.vstack([start, way]), axis=0).T).sum())


def router(fence: Fence, need_m: float = 1.0) -> tuple[Zones, Router]:
    zones = pack_zones(fence)
    return zones, Router(zones, np.full(len(zones.radius), need_m))


TRAP = ((5.0, -5.0), (12.0, -5.0), (12.0, 5.0), (5.0, 5.0), (5.0, 4.0), (11.0, 4.0), (11.0, -4.0), (5.0, -4.0))
FENCES = {
    "disc": Fence(margin_m=0.0, keep_out_disc=(disc(10.0, 0.5, 3.0),)),
    "two": Fence(margin_m=0.0, keep_out_disc=(disc(6.0, 0.5, 3.0), disc(14.0, -1.0, 2.0))),
    "trap": Fence(margin_m=0.0, keep_out=(polygon(*TRAP),)),
    "bay": Fence(
        margin_m=0.0, keep_in=(polygon((-3, -9), (25, -9), (25, 9), (12, 9), (12, -4), (9, -4), (9, 9), (-3, 9)),)
    ),
}
START, GOAL = np.array([0.0, 0.0]), np.array([20.0, 0.0])


@pytest.mark.parametrize("name", FENCES)
def test_a_way_keeps_the_clearance_and_reaches_the_goal(name: str) -> None:
    zones, of = router(FENCES[name])
    assert of.is_blocked(START, GOAL)
    way = of.way(START, GOAL)
    np.testing.assert_array_equal(way[-1], GOAL)
    assert clearances(zones, along(START, way)).min() > 1.0 - 2e-3


def test_the_way_to_another_point_is_not_that_to_the_one_before() -> None:
    """The second point is the first one seen from the other side of the origin."""
    fence = Fence(margin_m=0.0, keep_out_disc=(disc(10.0, 0.5, 3.0), disc(-10.0, 0.5, 3.0)))
    zones, of = router(fence)
    for goal in (GOAL, -GOAL):
        way = of.way(START, goal, remember=False)
        assert clearances(zones, along(START, way)).min() > 1.0 - 2e-3
        assert length(START, way) < 21.5


def shortest(of: Router, start: Array, goal: Array) -> float:
    """Return the length of the shortest way over all nodes (m)."""
    points = np.vstack([start, goal, of.nodes])
    seen = np.zeros((len(points), len(points)))
    for i, j in itertools.combinations(range(len(points)), 2):
        if not of.is_blocked(points[i], points[j]):
            seen[i, j] = math.dist(points[i], points[j])
    return float(dijkstra(csr_array(seen), directed=False, indices=0)[1])


def test_among_many_zones_every_way_is_the_shortest_one() -> None:
    random, discs = np.random.default_rng(3), []
    while len(discs) < 12:
        north, east = random.uniform(-20.0, 20.0, 2)
        if all(math.hypot(north - n, east - e) > 6.5 for n, e in discs):
            discs.append((north, east))
    squares = [polygon((n - 2, e - 2), (n - 2, e + 2), (n + 2, e + 2), (n + 2, e - 2)) for n, e in discs[6:]]
    fence = Fence(margin_m=0.0, keep_out=tuple(squares), keep_out_disc=tuple(disc(n, e, 2.0) for n, e in discs[:6]))
    _, of = router(fence, need_m=0.5)
    turns = 0
    for goal in ((-24.0, -24.0), (24.0, 3.0), (24.0, 3.0), (24.0, 24.0)):
        for start in ((-23.0, 22.0), (-22.0, -20.0), (1.0, -24.0)):
            way = of.way(np.array(start), np.array(goal), remember=False)
            assert length(np.array(start), way) == pytest.approx(shortest(of, np.array(start), np.array(goal)))
            turns = max(turns, len(way) - 1)
    assert turns > 2


def test_a_router_serves_clearances_a_little_larger_or_up_to_a_fifth_smaller() -> None:
    _, of = router(FENCES["two"])
    for need, serves in (([1.04, 1.0], True), ([1.0, 1.06], False), ([0.81, 1.0], True), ([1.0, 0.79], False)):
        assert of.serves(np.array(need)) is serves


def test_a_way_round_a_disc_is_hardly_longer_than_the_tangents() -> None:
    _, of = router(FENCES["disc"])
    # both points are at distance d from the centre: tangents and the arc between them
    reach, d = 4.0, (math.hypot(10.0, 0.5),) * 2
    angle = math.pi - 2.0 * math.atan2(0.5, 10.0) - sum(math.acos(reach / each) for each in d)
    shortest = sum(math.sqrt(each**2 - reach**2) for each in d) + reach * angle
    assert shortest <= length(START, of.way(START, GOAL)) < 1.02 * shortest


def test_a_way_is_kept_until_another_is_clearly_shorter() -> None:
    _, of = router(FENCES["disc"])
    assert of.way(START, GOAL)[0][1] < 0.5  # to port, where the disc reaches less far
    for east, side in ((0.7, -1.0), (0.9, -1.0), (1.5, -1.0), (1.8, 1.0), (4.0, 1.0)):
        way = of.way(np.array([3.0, east]), GOAL)
        assert np.sign(way[0][1] - 0.5) == side
    _, fresh = router(FENCES["disc"])
    assert fresh.way(np.array([3.0, 0.9]), GOAL)[0][1] > 0.5  # without memory it is the other side


def test_without_a_way_it_leads_to_the_nearest_point_that_can_be_reached() -> None:
    walls = (
        polygon((6, -6), (7, -6), (7, 6), (6, 6)),
        polygon((13, -6), (14, -6), (14, 6), (13, 6)),
        polygon((6, -7), (14, -7), (14, -6), (6, -6)),
        polygon((6, 6), (14, 6), (14, 7), (6, 7)),
    )
    zones, of = router(Fence(margin_m=0.0, keep_out=walls))
    goal = np.array([12.0, 0.0])
    way = of.way(START, goal)
    assert clearances(zones, along(START, way)).min() > 1.0 - 2e-3
    assert math.dist(way[-1], goal) < math.dist(START, goal)


@given(rings(), rings(), point, point)
def test_a_line_is_blocked_if_its_points_are_too_near(first: Array, second: Array, start: Pair, end: Pair) -> None:
    """A zone that an end is in does not count; an end that is too near lowers the clearance that counts."""
    zones, of = router(Fence(margin_m=0.0, keep_out=(shapes.polygon(first), shapes.polygon(second))))
    points = np.linspace(start, end, 100)
    free, step_m = clearances(zones, points), math.dist(start, end) / 99
    least = np.minimum(free[[0, -1]].min(axis=0), 1.0) - SLACK_M
    lacking = np.where(least > -SLACK_M, np.maximum(least, 0.0) - free.min(axis=0), -math.inf).max()
    if of.is_blocked(points[0], points[-1]):
        assert lacking > -0.5 * step_m - 1e-9
    else:
        assert lacking < 1e-9


def test_nothing_is_blocked_where_nothing_is_between() -> None:
    _, of = router(FENCES["disc"])
    assert not of.is_blocked(START, np.array([0.0, 9.0]))
    assert not of.chain_is_blocked(START, np.array([[0.0, 6.0], [20.0, 6.0]]))
    assert of.chain_is_blocked(START, np.array([[0.0, 6.0], [20.0, 0.0], [0.0, 0.0]]))
