"""Current model: prior over depth, random walk in time, published profile."""

import math

import msgspec
import numpy as np
import pytest

from ltv_mpc.currents import WaterPrior
from ltv_mpc.localisation import current_model
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.filter.state import Belief, Layout, grid
from ltv_mpc.localisation.sensor_config import SensorConfig

CONFIG = EstimatorConfig()
LAYOUT = Layout.of(SensorConfig.load("paper"), CONFIG)


def prior(config=CONFIG):
    belief = Belief.blank(LAYOUT, 0)
    current_model.write_prior(belief, config)
    return belief


def test_the_prior_is_that_of_a_gauss_markov_profile_of_unknown_mean_north_and_east_alike():
    """var of c[k+1] = a c[k] + w, which is stationary, plus that of the mean."""
    P, z = prior().P, grid(CONFIG)
    rho = math.exp(-1.0 / CONFIG.current_correlation_length_m)
    expected = CONFIG.current_sd_mps**2 * rho ** np.abs(z[:, None] - z) + CONFIG.current_mean_sd_mps**2
    np.testing.assert_allclose(P[LAYOUT.north, LAYOUT.north], expected)
    np.testing.assert_array_equal(P[LAYOUT.north, LAYOUT.north], P[LAYOUT.east, LAYOUT.east])
    assert not P[LAYOUT.north, LAYOUT.east].any()


def test_the_random_walk_is_independent_at_each_grid_point():
    config = msgspec.structs.replace(CONFIG, current_change_mps_per_rts=0.001)
    belief, before = prior(), prior().P
    current_model.add_random_walk(belief, config, 9.0)
    grown = belief.P - before
    np.testing.assert_allclose(np.diag(grown)[LAYOUT.north], 9e-6, rtol=1e-9)
    np.testing.assert_allclose(np.diag(grown)[LAYOUT.east], 9e-6, rtol=1e-9)
    assert np.count_nonzero(grown) == 2 * len(grid(config))


def test_a_published_profile_is_the_belief_with_the_larger_deviation_of_its_axes():
    belief = prior()
    belief.x[LAYOUT.north] = 0.1
    belief.x[LAYOUT.east] = -0.2
    belief.P[LAYOUT.east, LAYOUT.east] *= 4
    profile = current_model.profile(belief, grid(CONFIG))
    assert (profile.depth_m[3], profile.north_mps[3], profile.east_mps[3]) == (3.0, 0.1, -0.2)
    assert profile.sd_mps is not None
    assert profile.sd_mps[3] == pytest.approx(2 * math.hypot(0.04, 0.1))
    belief.x[:] = 7.0
    assert profile.north_mps[3] == 0.1, "a published profile does not change afterwards"


def saved(*rows, common_mps=0.0):
    """Return a saved profile of rows (depth, north, east, deviation)."""
    depth, north, east, sd = np.array(rows).T
    return WaterPrior(depth_m=depth, north_mps=north, east_mps=east, sd_mps=sd, sd_common_mps=common_mps)


SAVED = saved(
    (5.0, 0.1, -0.1, 0.02), (6.0, 0.2, -0.2, 0.03), (7.0, 0.3, -0.3, 0.04), (15.0, -0.1, 0.5, 0.01), common_mps=0.01
)


def test_at_saved_depths_the_prior_is_the_profile_plus_its_possible_change():
    config = msgspec.structs.replace(CONFIG, water_prior_change_sd_mps=0.003)
    belief = Belief.blank(LAYOUT, 0)
    current_model.write_prior(belief, config, SAVED)
    for z, north, east, sd in zip(SAVED.depth_m, SAVED.north_mps, SAVED.east_mps, SAVED.sd_mps, strict=True):
        n, e = LAYOUT.north.start + int(z), LAYOUT.east.start + int(z)
        assert (belief.x[n], belief.x[e]) == (pytest.approx(north), pytest.approx(east))
        assert belief.P[n, n] == belief.P[e, e] == pytest.approx(sd**2 + 0.003**2)
        assert belief.P[LAYOUT.mean.start, n] == belief.P[e, LAYOUT.mean.start + 1] == pytest.approx(0.01**2)


def test_saved_depths_share_their_common_error_and_that_of_neighbours():
    config = msgspec.structs.replace(CONFIG, water_prior_change_sd_mps=0.0)
    covariance = current_model.node_prior(config, SAVED).covariance()
    own = np.sqrt(SAVED.sd_mps**2 - 0.01**2)
    distance = math.exp(-1 / CONFIG.current_correlation_length_m)
    assert covariance[5, 6] == pytest.approx(0.01**2 + own[0] * own[1] * distance)
    assert covariance[5, 7] == pytest.approx(0.01**2 + own[0] * own[2] * distance**2)


def test_between_saved_depths_the_prior_is_a_gauss_markov_bridge():
    """Reference: Gaussian conditioning on an exactly known profile."""
    exact = saved((10.0, 0.1, 0.0, 0.0), (30.0, 0.3, 0.0, 0.0))
    config = msgspec.structs.replace(CONFIG, water_prior_change_sd_mps=0.0)
    prior = current_model.node_prior(config, exact)
    z = np.arange(71)
    K = CONFIG.current_sd_mps**2 * np.exp(-np.abs(z[:, None] - z) / CONFIG.current_correlation_length_m)
    ends = [10, 30]
    given = np.diag(K - K[:, ends] @ np.linalg.solve(K[np.ix_(ends, ends)], K[ends]))
    np.testing.assert_allclose(prior.sd_mps[10:31] ** 2, given[10:31], atol=1e-12)
    np.testing.assert_allclose(prior.mean_mps[10:31, 0], np.linspace(0.1, 0.3, 21))


def test_far_beyond_a_saved_profile_the_prior_is_as_open_as_one_without():
    deep = msgspec.structs.replace(CONFIG, deepest_m=200.0)
    saved, without = current_model.node_prior(deep, SAVED), current_model.node_prior(deep)
    assert saved.covariance()[200, 200] == pytest.approx(without.covariance()[200, 200])
    depth = SAVED.depth_m
    mean = np.trapezoid(SAVED.north_mps, depth) / 10.0
    assert saved.mean_mps[200, 0] == pytest.approx(mean)
    assert np.all(np.diff(saved.sd_mps[15:]) > -1e-12), "deviations grow with the distance"
    end = SAVED.north_mps[-1]
    assert saved.mean_mps[23, 0] == pytest.approx(mean + math.exp(-1.0) * (end - mean))


def test_a_profile_of_one_depth_is_a_prior_too():
    prior = current_model.node_prior(CONFIG, saved((20.0, 0.3, 0.1, 0.02), common_mps=0.02))
    np.testing.assert_allclose(prior.mean_mps, np.tile([0.3, 0.1], (71, 1)))
    assert prior.sd_mps[20] == pytest.approx(CONFIG.water_prior_change_sd_mps)
    assert np.all(np.isfinite(prior.sd_mps))
