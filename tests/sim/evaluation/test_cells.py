"""Projection of the true current onto the depth grid of the filter."""

import numpy as np
import pytest

from sim.evaluation.cells import GridProjection

NODE_M = np.arange(0.0, 21.0, 2.0)
FINE_M = np.linspace(0.0, 20.0, 200_001)


def bending_at(bend_m, rng):
    values = rng.standard_normal((len(bend_m), 2))
    return lambda depth_m: np.column_stack([np.interp(depth_m, bend_m, axis) for axis in values.T])


def mean_square(c, water):
    lines = np.column_stack([np.interp(FINE_M, NODE_M, axis) for axis in c.T])
    square = np.sum((lines - water(FINE_M)) ** 2, axis=1)
    return np.trapezoid(square, FINE_M) / 20.0


@pytest.mark.parametrize(
    "bend_m", [NODE_M, np.arange(-4.0, 30.0, 4.0)], ids=["at nodes", "at every second, and beyond"]
)
def test_water_that_bends_at_nodes_alone_is_held_as_it_is(bend_m):
    water = bending_at(bend_m, np.random.default_rng(1))
    cells = GridProjection(NODE_M, bend_m)
    np.testing.assert_allclose(cells.fit(water(cells.depth_m)), water(NODE_M), atol=1e-14)


def test_of_other_water_nothing_fits_better():
    rng = np.random.default_rng(2)
    bend_m = np.array([-3.0, 0.7, 5.5, 6.1, 6.9, 13.0, 19.9, 25.0])
    water, cells = bending_at(bend_m, rng), GridProjection(NODE_M, bend_m)
    at = water(cells.depth_m)
    best = cells.fit(at)
    least = mean_square(best, water)
    for k in range(len(NODE_M)):
        for axis in range(2):
            for d in (-1e-3, 1e-3):
                other = best.copy()
                other[k, axis] += d
                assert mean_square(other, water) > least


def test_of_a_jump_within_a_cell_its_nodes_hold_more_than_the_water_does():
    bend_m = np.array([0.0, 8.5, 9.5, 20.0])
    cells = GridProjection(NODE_M, bend_m)
    water = np.column_stack([np.interp(cells.depth_m, bend_m, [0.0, 0.0, 1.0, 1.0]), np.zeros(len(cells.depth_m))])
    north, east = cells.fit(water).T
    assert north[4] < -0.05  # 8 m, where the water is 0
    assert north[5] > 1.05  # 10 m, where it is 1
    assert north[4] + north[5] == pytest.approx(
        1.0, abs=1e-5
    )  # nothing tells one side from the other, but the column's ends
    assert not east.any()
