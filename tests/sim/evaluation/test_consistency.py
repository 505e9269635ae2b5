"""Consistency with draws of known covariance, and errors against the filter's error convention."""

import numpy as np
import pytest
from scipy.stats import chi2

from ltv_mpc.frames import rotation, rotation_exp
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.filter.state import Belief, Layout, grid
from ltv_mpc.localisation.sensor_config import SensorConfig
from sim.evaluation.consistency import (
    TrueState,
    band,
    consistency,
    drawn,
    errors,
    nees,
    nodes_around,
    quantities,
    squared,
)

RUNS, INSTANTS = 20, 1000
PAPER, REALISTIC = SensorConfig.load("paper"), SensorConfig.load("realistic")


def spread(rng, n):
    """Return a covariance whose states differ by 1e4 in size."""
    A = rng.standard_normal((n, n + 2)) * 10.0 ** rng.uniform(-4, 0, n)[:, None]
    return A @ A.T


def ensemble(said_over_true, n=3):
    """Squares and degrees of freedom of errors drawn from P, held against ``said_over_true`` P."""
    rng = np.random.default_rng(5)
    P = spread(rng, n)
    e = rng.standard_normal((RUNS, INSTANTS, n)) @ np.linalg.cholesky(P).T
    squares = np.array([[squared(x, said_over_true * P) for x in run] for run in e])
    return consistency(squares, np.full(squares.shape, n))


def test_a_consistent_ensemble_is_inside_its_band_at_95_per_cent_of_instants():
    result = ensemble(1.0)
    assert 0.93 < result.in_band < 0.97  # 1000 instants: 0.95 +- 0.007
    assert abs(result.per_dof - 1) < 0.02


@pytest.mark.parametrize("factor", [1 / 1.5, 1.5])
def test_a_covariance_that_is_wrong_by_half_is_not(factor):
    """60 degrees of freedom: the sum is 2 to 3 of its standard deviations off, at the edge of the band."""
    result = ensemble(factor)
    assert result.in_band < 0.6
    np.testing.assert_allclose(result.per_dof, 1 / factor, rtol=0.02)


def test_runs_of_different_dimension_are_banded_by_what_they_have_together():
    """Cells that are seen differ from run to run; an instant that no run has is left out."""
    rng = np.random.default_rng(6)
    dof = rng.integers(0, 40, (RUNS, INSTANTS))
    dof[:, 7] = 0
    result = consistency(rng.chisquare(np.maximum(dof, 1e-9)), dof)
    assert len(result.total) == INSTANTS - 1
    np.testing.assert_array_equal(result.dof, np.delete(dof.sum(axis=0), 7))
    assert 0.93 < result.in_band < 0.97
    assert abs(result.per_dof - 1) < 0.02
    with pytest.raises(ValueError, match="no sample"):
        consistency(np.zeros((2, 3)), np.zeros((2, 3)))


@pytest.mark.parametrize("dof", [1, 20, 60, 5000])
def test_the_band_is_that_of_chi_square(dof):
    low, high = band(dof)
    np.testing.assert_allclose([low, high], [chi2.ppf(0.025, dof), chi2.ppf(0.975, dof)], rtol=1e-9)


def test_the_square_is_that_of_the_inverse_and_does_not_depend_on_units():
    rng = np.random.default_rng(7)
    P, e = spread(rng, 6), rng.standard_normal(6)
    unit = np.diag(10.0 ** rng.uniform(-3, 3, 6))
    np.testing.assert_allclose(squared(e, P), e @ np.linalg.inv(P) @ e, rtol=1e-8)
    np.testing.assert_allclose(squared(unit @ e, unit @ P @ unit), squared(e, P), rtol=1e-8)
    with pytest.raises(np.linalg.LinAlgError):
        squared(np.ones(2), np.array([[1.0, 2.0], [2.0, 1.0]]))
    with pytest.raises(np.linalg.LinAlgError):
        squared(np.ones(2), np.diag([1.0, 0.0]))


CONFIG = EstimatorConfig(deepest_m=20.0)


def belief_and_truth(suite, seed=8):
    """Return a belief, an error, and the truth that has it, made by the filter's own rule, ``Belief.add``."""
    rng = np.random.default_rng(seed)
    layout = Layout.of(suite, CONFIG)
    belief = Belief.blank(layout, 0)
    belief.x[:] = rng.standard_normal(layout.size)
    belief.R, belief.mounting = rotation(0.1, -0.2, 2.0), rotation_exp(0.1 * rng.standard_normal(3))
    A = rng.standard_normal((layout.size, layout.size + 5))
    belief.P[:] = A @ A.T
    error = 0.3 * rng.standard_normal(layout.size)
    true = belief.copy()
    true.apply_error(error)
    x, water = true.x, rng.standard_normal((len(grid(CONFIG)), 2))
    window = slice(belief.column.first, belief.column.first + layout.north.stop - layout.north.start)
    water[window] = np.column_stack([x[layout.north], x[layout.east]])
    beam, near, compass = (np.zeros(4), np.zeros(4), 0.0)
    if suite is REALISTIC:
        beam, near, compass = x[layout.beam_bias], x[layout.near_bias], float(x[layout.compass_bias][0])
    truth = TrueState(x[:3], x[3:6], true.R, x[9:12], x[12:15], beam, near, true.mounting, compass, water)
    return belief, truth, error


@pytest.mark.parametrize("suite", [PAPER, REALISTIC], ids=["paper", "realistic"])
def test_an_error_is_what_the_filter_would_have_to_add(suite):
    belief, truth, error = belief_and_truth(suite)
    graded = np.concatenate(list(quantities(belief, np.ones(len(truth.water_mps), dtype=bool)).values()))
    np.testing.assert_allclose(errors(truth, belief)[graded], error[graded], atol=1e-12)


def test_each_quantity_is_graded_by_its_own_states_and_only_what_exists():
    belief, truth, _ = belief_and_truth(REALISTIC)
    layout, e, P = belief.layout, errors(truth, belief), belief.P
    seen = np.zeros(len(truth.water_mps), dtype=bool)
    seen[[2, 3, 5]] = True
    by_name = nees(belief, truth, seen)
    assert {name: dof for name, (_, dof) in by_name.items()} == {
        "position": 3,
        "velocity": 3,
        "heading": 1,
        "tilt": 2,
        "gyro_bias": 3,
        "accelerometer_bias": 3,
        "adcp_bias": 8,
        "compass_bias": 1,
        "mounting": 3,
        "cells": 6,
    }
    np.testing.assert_allclose(by_name["heading"][0], e[8] ** 2 / P[8, 8])
    i = np.array([*range(layout.beam_bias.start, layout.near_bias.stop)])
    np.testing.assert_allclose(by_name["adcp_bias"][0], e[i] @ np.linalg.inv(P[np.ix_(i, i)]) @ e[i])
    k = np.array([2, 3, 5]) - belief.column.first
    i = np.concatenate([layout.north.start + k, layout.east.start + k])
    np.testing.assert_allclose(by_name["cells"][0], e[i] @ np.linalg.inv(P[np.ix_(i, i)]) @ e[i])
    plain, truth, _ = belief_and_truth(PAPER)
    assert set(nees(plain, truth, ~seen & False)) == {
        "position",
        "velocity",
        "heading",
        "tilt",
        "gyro_bias",
        "accelerometer_bias",
    }


def test_a_state_that_the_filter_is_certain_of_is_not_graded():
    belief, truth, _ = belief_and_truth(PAPER)
    belief.P[12], belief.P[:, 12] = 0.0, 0.0
    square, dof = nees(belief, truth, np.zeros(21, dtype=bool))["accelerometer_bias"]
    e, P = errors(truth, belief)[13:15], belief.P[13:15, 13:15]
    assert dof == 2
    np.testing.assert_allclose(square, e @ np.linalg.inv(P) @ e)


def test_seen_are_the_two_nodes_around_each_cell():
    seen = nodes_around(np.array([[0.2, 3.0], [-0.5, 6.9], [9.5, 40.0]]), 1.0, 11)
    assert np.flatnonzero(seen).tolist() == [0, 1, 3, 4, 6, 7, 9, 10]
    assert np.flatnonzero(nodes_around(np.array([3.0]), 2.0, 5)).tolist() == [1, 2]


def test_biases_drawn_as_the_sensors_file_says_have_a_mean_square_of_one():
    rng = np.random.default_rng(9)
    _, truth, _ = belief_and_truth(REALISTIC)
    total: dict[str, float] = {}
    degrees: dict[str, int] = {}
    imu, adcp, compass = REALISTIC.imu, REALISTIC.adcp, REALISTIC.compass
    for _ in range(400):
        truth = truth._replace(
            gyro_bias_radps=imu.gyro_bias_sd_radps * rng.standard_normal(3),
            accelerometer_bias_mps2=imu.accelerometer_bias_sd_mps2 * rng.standard_normal(3),
            beam_bias_mps=adcp.beam_bias_sd_mps * rng.standard_normal(4),
            near_bias_mps=adcp.near_bias_sd_mps * rng.standard_normal(4),
            compass_bias_rad=compass.bias_sd_rad * rng.standard_normal(),
            mounting=rotation_exp(adcp.mounting_known_to_rad * rng.standard_normal(3)),
        )
        for name, (square, dof) in drawn(truth, REALISTIC).items():
            total[name], degrees[name] = total.get(name, 0.0) + square, degrees.get(name, 0) + dof
    assert degrees == {
        "gyro_bias": 1200,
        "accelerometer_bias": 1200,
        "adcp_bias": 3200,
        "compass_bias": 400,
        "mounting": 1200,
    }
    for name, square in total.items():
        low, high = band(degrees[name], 0.9999)
        assert low < square < high, name
    assert set(drawn(truth, PAPER)) == {"gyro_bias", "accelerometer_bias"}
