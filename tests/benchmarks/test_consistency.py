"""Consistency with draws of known covariance, errors by the filter's convention, and the projection of the water."""

import numpy as np
import pytest
from scipy.stats import chi2

from benchmarks.localisation_check.consistency import (
    GridProjection,
    TrueState,
    consistency,
    errors,
    nees,
    nodes_around,
    quantities,
    squared,
)
from ltv_mpc.frames import rotation, rotation_exp
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.filter.state import Belief, Layout, grid
from ltv_mpc.localisation.sensor_config import SensorConfig

PAPER, REALISTIC = SensorConfig.load("paper"), SensorConfig.load("realistic")
CONFIG = EstimatorConfig(deepest_m=20.0)
GRID_M = np.arange(0.0, 21.0, 2.0)


@pytest.mark.parametrize(("ratio", "in_band"), [(1.0, (0.93, 0.97)), (1 / 1.5, (0.0, 0.6)), (1.5, (0.0, 0.6))])
def test_errors_lie_in_the_band_at_95_percent_of_instants_if_the_covariance_is_right(ratio, in_band):
    """20 runs of 3 degrees of freedom: a covariance wrong by half moves the sum by 2 to 3 of its deviations."""
    rng = np.random.default_rng(5)
    A = rng.standard_normal((3, 5)) * 10.0 ** rng.uniform(-4, 0, 3)[:, None]  # states differ by 1e4 in size
    P = A @ A.T
    e = rng.standard_normal((20, 1000, 3)) @ np.linalg.cholesky(P).T
    result = consistency(np.array([[squared(x, ratio * P) for x in run] for run in e]), np.full(e.shape[:2], 3))
    assert in_band[0] < result.in_band < in_band[1]
    assert result.per_dof == pytest.approx(1 / ratio, rel=0.02)


def test_an_instant_that_no_run_has_is_left_out():
    """Degrees of freedom differ from run to run; the band is that of their sum."""
    rng = np.random.default_rng(6)
    dof = rng.integers(0, 40, (20, 1000))
    dof[:, 7] = 0
    result = consistency(rng.chisquare(np.maximum(dof, 1e-9)), dof)
    total = np.delete(dof.sum(axis=0), 7)
    np.testing.assert_array_equal(result.dof, total)
    np.testing.assert_allclose([result.low, result.high], [chi2.ppf(0.025, total), chi2.ppf(0.975, total)], rtol=1e-9)
    assert 0.93 < result.in_band < 0.97
    with pytest.raises(ValueError, match="no sample"):
        consistency(np.zeros((2, 3)), np.zeros((2, 3)))


def belief_and_truth(sensors):
    """Return a belief, an error, and the truth that has it by the filter's own rule, ``Belief.apply_error``."""
    rng = np.random.default_rng(8)
    layout = Layout.of(sensors, CONFIG)
    belief = Belief.blank(layout, 0)
    belief.x[:] = rng.standard_normal(layout.size)
    belief.R, belief.mounting = rotation(0.1, -0.2, 2.0), rotation_exp(0.1 * rng.standard_normal(3))
    A = rng.standard_normal((layout.size, layout.size + 5))
    belief.P[:] = A @ A.T
    error, true = 0.3 * rng.standard_normal(layout.size), belief.copy()
    true.apply_error(error)
    x, water = true.x, rng.standard_normal((len(grid(CONFIG)), 2))
    cells = layout.north.stop - layout.north.start
    water[belief.column.first : belief.column.first + cells] = np.column_stack([x[layout.north], x[layout.east]])
    beam, near, compass = (np.zeros(4), np.zeros(4), 0.0)
    if sensors is REALISTIC:
        beam, near, compass = x[layout.beam_bias], x[layout.near_bias], float(x[layout.compass_bias][0])
    return (
        belief,
        TrueState(x[:3], x[3:6], true.R, x[9:12], x[12:15], beam, near, true.mounting, compass, water),
        error,
    )


@pytest.mark.parametrize("sensors", [PAPER, REALISTIC], ids=["paper", "realistic"])
def test_each_quantity_is_judged_by_the_errors_of_its_own_states(sensors):
    belief, truth, error = belief_and_truth(sensors)
    observed = np.zeros(len(truth.water_mps), dtype=bool)
    observed[[2, 3, 5]] = True
    belief.P[12], belief.P[:, 12] = 0.0, 0.0  # a certain state is left out
    expected = {"position": 3, "velocity": 3, "heading": 1, "tilt": 2, "gyro_bias": 3, "accelerometer_bias": 2}
    if sensors is REALISTIC:
        expected |= {"adcp_bias": 8, "compass_bias": 1, "mounting": 3}
    found = nees(belief, truth, observed)
    assert {name: dof for name, (_, dof) in found.items()} == expected | {"cells": 6}
    for name, states in quantities(belief, observed).items():
        np.testing.assert_allclose(errors(truth, belief)[states], error[states], atol=1e-12)
        i = states[states != 12]
        np.testing.assert_allclose(found[name][0], error[i] @ np.linalg.inv(belief.P[np.ix_(i, i)]) @ error[i])


def test_observed_are_the_two_grid_points_around_each_cell():
    observed = nodes_around(np.array([[0.2, 3.0], [-0.5, 6.9], [9.5, 40.0]]), 1.0, 11)
    assert np.flatnonzero(observed).tolist() == [0, 1, 3, 4, 6, 7, 9, 10]
    assert np.flatnonzero(nodes_around(np.array([3.0]), 2.0, 5)).tolist() == [1, 2]


def test_the_projection_of_water_is_its_best_fit_by_lines_between_grid_points():
    rng = np.random.default_rng(2)
    bend_m, fine_m = np.array([-3.0, 0.7, 5.5, 6.1, 6.9, 13.0, 19.9, 25.0]), np.linspace(0.0, 20.0, 20_001)
    values = rng.standard_normal(len(bend_m))
    projection = GridProjection(GRID_M, bend_m)
    best = projection.fit(np.interp(projection.depth_m, bend_m, values)[:, None])[:, 0]

    def mean_square(c):
        return np.trapezoid((np.interp(fine_m, GRID_M, c) - np.interp(fine_m, bend_m, values)) ** 2, fine_m)

    for k in range(len(GRID_M)):
        for d in (-1e-3, 1e-3):
            assert mean_square(best + d * (np.arange(len(GRID_M)) == k)) > mean_square(best)
    even = GridProjection(GRID_M, GRID_M[::2])  # water that bends at grid points alone
    np.testing.assert_allclose(
        even.fit(np.interp(even.depth_m, GRID_M, GRID_M**2)[:, None])[:, 0], GRID_M**2, atol=1e-10
    )
