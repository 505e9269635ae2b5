"""Gauss-Markov current against the stationary distribution of its truncated chain, computed on a grid."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import norm, truncnorm

from sim.random_streams import Stream, generator
from sim.scenario import Water
from sim.water import make, markov

SEEDS = 1500
CELLS = 71
SD, LENGTH = 0.04, 8.0


@pytest.fixture(scope="module")
def profiles():
    """Return currents of many seeds, (SEEDS, CELLS, 2), for the paper's scenario."""
    return np.array([make(Water(), seed).over(np.arange(CELLS), 0) for seed in range(SEEDS)])


def stationary(bound: float, points: int = 801) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return transition matrix and stationary distribution on a grid of the chain that redraws beyond the bound."""
    a = math.exp(-1.0 / LENGTH)
    x = np.linspace(-bound, bound, points)
    P = norm.pdf((x[None, :] - a * x[:, None]) / math.sqrt(1 - a * a))
    P /= P.sum(axis=1, keepdims=True)
    law = np.full(points, 1.0 / points)
    for _ in range(400):
        law = law @ P
    return x, P, law


def test_the_standard_deviation_is_that_of_the_cut_chain_at_every_depth(profiles):
    x, _, law = stationary(3.0)
    sd = SD * math.sqrt(law @ x**2)
    assert 0.98 * SD < sd < 0.99 * SD
    samples = 2 * SEEDS
    # Nine in ten thousand beyond 3.3 of the estimate's own sd; 71 depths, so 4.5.
    measured = profiles.transpose(1, 0, 2).reshape(CELLS, -1).std(axis=1)
    np.testing.assert_allclose(measured, sd, rtol=4.5 / math.sqrt(2 * samples))
    assert profiles.std() == pytest.approx(sd, rel=0.015)
    assert 2.9 * SD < np.abs(profiles).max() <= 3.0 * SD
    assert abs(profiles.mean()) < 4 * sd * math.sqrt(2 * LENGTH / (SEEDS * 2 * CELLS))


@pytest.mark.parametrize("cells_apart", [1, 4, 8, 16])
def test_depths_are_correlated_as_the_length_says(profiles, cells_apart):
    x, P, law = stationary(3.0)
    expected = (law * x) @ np.linalg.matrix_power(P, cells_apart) @ x / (law @ x**2)
    assert expected == pytest.approx(math.exp(-cells_apart / LENGTH), abs=0.02)
    upper, lower = profiles[:, :-cells_apart], profiles[:, cells_apart:]
    assert (upper * lower).mean() / (profiles**2).mean() == pytest.approx(expected, abs=0.02)


def test_a_bound_of_two_shrinks_the_standard_deviation_to_six_sevenths():
    x, _, law = stationary(2.0)
    assert math.sqrt(law @ x**2) == pytest.approx(0.857, abs=0.002)
    draws = generator(5, Stream.WATER_NORTH)
    series = markov.series(draws, 60_000, sd_mps=1.0, cell_m=1.0, correlation_length_m=LENGTH, bound_sd=2.0)
    assert np.abs(series).max() <= 2.0
    assert series.std() == pytest.approx(math.sqrt(law @ x**2), rel=0.02)


def test_the_first_depth_already_has_the_statistics_of_all_others():
    """Under a tight bound they differ clearly from those of a normal distribution that is only cut."""
    x, _, law = stationary(1.0)
    draws = generator(6, Stream.WATER_NORTH)
    settings = {"sd_mps": 1.0, "cell_m": 1.0, "correlation_length_m": LENGTH, "bound_sd": 1.0}
    first = np.array([markov.series(draws, 1, **settings)[0] for _ in range(20_000)])
    expected = math.sqrt(law @ x**2)
    assert first.std() == pytest.approx(expected, rel=4 / math.sqrt(40_000))
    assert truncnorm(-1, 1).std() > 1.05 * expected


def test_north_and_east_are_independent_and_so_are_seeds(profiles):
    north, east = profiles[:, :, 0], profiles[:, :, 1]
    spread = math.sqrt(2 * LENGTH / (SEEDS * CELLS))
    assert abs(np.corrcoef(north.ravel(), east.ravel())[0, 1]) < 4 * spread
    assert abs(np.corrcoef(north[1:].ravel(), north[:-1].ravel())[0, 1]) < 4 * spread


@pytest.mark.parametrize(("bound", "cell", "length"), [(1e-6, 1.0, 8.0), (10.0, 0.01, 1000.0), (3.0, 100.0, 0.01)])
def test_extreme_settings_end_and_stay_finite(bound, cell, length):
    draws = generator(1, Stream.WATER_EAST)
    series = markov.series(draws, 200, sd_mps=1.0, cell_m=cell, correlation_length_m=length, bound_sd=bound)
    assert np.isfinite(series).all()
    assert np.abs(series).max() <= bound


def test_without_a_current_the_water_stands():
    water = make(Water(sd_mps=0.0), 3)
    assert water.at(12.3, 0) == (0.0, 0.0)
