"""Saved survey of the water: consistent at each depth and on average over depth."""

import msgspec
import numpy as np
import pytest

from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.filter.state import Belief, Layout, grid
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.water.current_model import node_prior, write_prior
from ltv_mpc.localisation.water.survey import prior_from

REALISTIC = SensorConfig.load("realistic")
QUIET = {
    "senses_earth_rate": False,
    "gyro_bias_sd_radps": 0.0,
    "angle_random_walk_rad_per_rts": 1e-9,
    "accelerometer_bias_tau_s": 1e9,
}
"""The inertial unit of ``make_yoyo``, which holds the vehicle level."""
SUITE = msgspec.structs.replace(
    REALISTIC,
    adcp=msgspec.structs.replace(REALISTIC.adcp, range_m=7.0, lever_arm_m=(0.0, 0.0, 0.0)),
    imu=msgspec.structs.replace(REALISTIC.imu, **QUIET),
)
WHOLE = msgspec.structs.replace(EstimatorConfig(), deepest_m=40.0, gate_probability=1.0, adapts_to_water=False)
WINDOW = msgspec.structs.replace(WHOLE, kept_m=0.0)
UNCHANGED = msgspec.structs.replace(WHOLE, water_prior_change_sd_mps=0.0)


def of(run, which=0):
    """Return the saved profile and its error (2, K)."""
    profile = prior_from(run.filters[which].belief, grid(WHOLE))
    nodes = np.round(profile.depth_m).astype(int)
    return profile, run.water[nodes].T - [profile.north_mps, profile.east_mps]


def test_errors_of_a_saved_profile_are_consistent_at_each_depth_and_on_average(make_yoyo):
    """30 dives. Squared errors in units of the variance; of the average over depth, of what a later prior makes of it.

    Errors of one dive are alike, so there are some 60 of them; 0.6 to 1.5 holds 99 % of such means.
    """
    depth, average, told = [], [], []
    for seed in range(30):
        profile, error = of(make_yoyo(SUITE, [WINDOW], seed, (0.0, 25.0)))
        depth.append(np.mean(error**2, axis=0) / profile.sd_mps**2)
        nodes = slice(int(profile.depth_m[0]), int(profile.depth_m[-1]) + 1)
        told.append(node_prior(UNCHANGED, profile).covariance(nodes).mean())
        average.append(np.mean(error, axis=1) ** 2)
    by_depth = np.mean([d[:28] for d in depth], axis=0)
    assert np.all((by_depth > 0.5) & (by_depth < 1.6)), by_depth
    assert 0.6 < np.mean(by_depth) < 1.5
    assert 0.6 < np.mean(average) / np.mean(told) < 1.5


def test_a_second_dive_with_a_saved_profile_is_more_accurate_and_consistent(make_yoyo):
    """The water is the same: velocity after 30 s against the same dive without a prior, and its squared error."""
    nees, ratio = [], []
    for seed in range(8):
        first = make_yoyo(SUITE, [WINDOW], seed, (0.0, 15.0))
        profile, _ = of(first)
        again = {
            told: make_yoyo(
                SUITE, [WINDOW], 1000 + seed, (0.0, 15.0), water=first.water, saved=profile if told else None
            )
            for told in (True, False)
        }
        beliefs = {told: run.filters[0].belief for told, run in again.items()}
        error = again[True].velocity[:2] - beliefs[True].x[3:5]
        nees.append(error @ np.linalg.solve(beliefs[True].P[3:5, 3:5], error) / 2)
        ratio.append(np.sqrt(beliefs[True].P[3, 3] / beliefs[False].P[3, 3]))
    assert 0.4 < np.mean(nees) < 1.7
    assert np.mean(ratio) < 0.9


def test_a_profile_saved_by_a_window_is_that_of_a_filter_that_keeps_every_depth(make_yoyo):
    """Dropped depths are included, with later knowledge of their neighbours."""
    run = make_yoyo(SUITE, [WHOLE, WINDOW], 3, (0.0, 25.0))
    (whole, _), (window, _) = of(run, 0), of(run, 1)
    assert len(run.filters[1].belief.column.dropped) > 10
    np.testing.assert_array_equal(window.depth_m, whole.depth_m)
    np.testing.assert_allclose(window.sd_mps, whole.sd_mps, rtol=0.1)
    assert np.abs(window.north_mps - whole.north_mps).max() < 0.5 * whole.sd_mps.min()
    assert window.sd_common_mps == pytest.approx(whole.sd_common_mps, rel=0.1)


def test_the_variance_of_each_depth_and_of_their_average_are_those_of_the_belief():
    """Random covariances with a common part and an own part at each depth."""
    rng = np.random.default_rng(0)
    belief = Belief.blank(Layout.of(SUITE, WHOLE), 0)
    write_prior(belief, WHOLE)
    north, east = belief.layout.north, belief.layout.east
    cells = north.stop - north.start
    own = rng.uniform(0.5, 1.0, cells) * 1e-4
    for axis, common in ((north, 2e-4), (east, 1e-4)):
        belief.P[axis, axis] = common + np.diag(own)
    belief.column.observed[:] = True
    profile = prior_from(belief, grid(WHOLE))
    np.testing.assert_allclose(profile.sd_mps**2, own + 2e-4)  # the larger of the two
    assert profile.sd_common_mps == pytest.approx(np.sqrt(min(1.5e-4, own.min() + 1e-4)))


def test_only_depths_between_the_uppermost_and_the_lowest_seen_are_saved():
    belief = Belief.blank(Layout.of(SUITE, WHOLE), 0)
    write_prior(belief, WHOLE)
    assert prior_from(belief, grid(WHOLE)) is None
    belief.column.mark_observed(np.array([4, 9]))
    np.testing.assert_array_equal(prior_from(belief, grid(WHOLE)).depth_m, np.arange(4.0, 11.0))
    belief = Belief.blank(Layout.of(SUITE, WHOLE), 0)
    write_prior(belief, WHOLE)
    belief.column.observed[7] = True
    alone = prior_from(belief, grid(WHOLE))
    assert (len(alone.depth_m), alone.sd_common_mps) == (1, 0.0)
