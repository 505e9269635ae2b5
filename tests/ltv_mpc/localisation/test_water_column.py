"""The prior over depth, the walk in time, and what is published."""

import math

import msgspec
import numpy as np
import pytest

from ltv_mpc.localisation import water_column
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.state import Belief, Layout, grid
from ltv_mpc.localisation.suite import Suite

CONFIG = EstimatorConfig()
LAYOUT = Layout.of(Suite.load("paper"), CONFIG)


def prior(config=CONFIG):
    belief = Belief.blank(LAYOUT, 0)
    water_column.write_prior(belief, config)
    return belief


def test_the_prior_is_what_a_simulated_gauss_markov_profile_of_unknown_mean_has():
    """Sample covariance of 40,000 profiles drawn cell by cell from c[k+1] = a c[k] + w."""
    rng = np.random.default_rng(0)
    count = 40_000
    a = math.exp(-1.0 / CONFIG.current_correlation_length_m)
    c = np.empty((30, count))
    c[0] = CONFIG.current_sd_mps * rng.standard_normal(count)
    for k in range(29):
        c[k + 1] = a * c[k] + CONFIG.current_sd_mps * math.sqrt(1 - a * a) * rng.standard_normal(count)
    c += CONFIG.current_mean_sd_mps * rng.standard_normal(count)
    north = prior().P[LAYOUT.north, LAYOUT.north]
    variance = CONFIG.current_sd_mps**2 + CONFIG.current_mean_sd_mps**2
    np.testing.assert_allclose(np.cov(c), north[:30, :30], atol=0.03 * variance)


def test_north_and_east_are_alike_and_independent():
    P = prior().P
    np.testing.assert_array_equal(P[LAYOUT.north, LAYOUT.north], P[LAYOUT.east, LAYOUT.east])
    assert not P[LAYOUT.north, LAYOUT.east].any()


def test_water_that_changes_walks_node_by_node():
    config = msgspec.structs.replace(CONFIG, current_change_mps_per_rts=0.001)
    belief, before = prior(), prior().P
    water_column.walk(belief, config, 9.0)
    grown = belief.P - before
    np.testing.assert_allclose(np.diag(grown)[LAYOUT.north], 9e-6, rtol=1e-9)
    np.testing.assert_allclose(np.diag(grown)[LAYOUT.east], 9e-6, rtol=1e-9)
    assert np.count_nonzero(grown) == 2 * len(grid(config))


def test_a_published_profile_is_the_belief_with_the_larger_deviation_of_its_axes():
    belief = prior()
    belief.x[LAYOUT.north] = 0.1
    belief.x[LAYOUT.east] = -0.2
    belief.P[LAYOUT.east, LAYOUT.east] *= 4
    profile = water_column.profile(belief, grid(CONFIG))
    assert (profile.depth_m[3], profile.north_mps[3], profile.east_mps[3]) == (3.0, 0.1, -0.2)
    assert profile.sd_mps is not None
    assert profile.sd_mps[3] == pytest.approx(2 * math.hypot(0.04, 0.1))
    belief.x[:] = 7.0
    assert profile.north_mps[3] == 0.1, "a published profile does not change afterwards"
