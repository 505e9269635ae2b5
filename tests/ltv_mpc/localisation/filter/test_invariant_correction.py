"""Invariant correction: beams and IMU alone give no information about heading."""

import math

import numpy as np
import pytest

from ltv_mpc.frames import rotation
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.filter.correction import reduce_covariance
from ltv_mpc.localisation.filter.error_state_filter import ErrorStateFilter
from ltv_mpc.localisation.filter.invariant_correction import heading_coupling
from ltv_mpc.localisation.filter.state import Belief, Layout
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.water.current_model import write_prior
from ltv_mpc.messages import AdcpPing, ImuSample

SUITE = SensorConfig.load("realistic")
CONFIG = EstimatorConfig()
LAYOUT = Layout.of(SensorConfig.load("paper"), CONFIG)
NOTHING = np.empty((0, LAYOUT.size))


def turn(x):
    """Return the unobservable direction N(x)."""
    N = np.zeros(LAYOUT.size)
    N[8] = 1
    N[3:5] = -x[4], x[3]
    N[LAYOUT.mean] = -x[LAYOUT.mean][1], x[LAYOUT.mean][0]
    N[LAYOUT.north], N[LAYOUT.east] = -x[LAYOUT.east], x[LAYOUT.north]
    return N


def test_the_direction_of_a_common_turn_moves_with_the_estimate():
    rng = np.random.default_rng(0)
    x, dx = rng.standard_normal((2, LAYOUT.size))
    P = np.outer(turn(x), turn(x))
    reduce_covariance(P, NOTHING, heading_coupling(dx, LAYOUT))
    np.testing.assert_allclose(P, np.outer(turn(x + dx), turn(x + dx)), atol=1e-12)


def test_it_is_a_congruence_and_keeps_symmetry():
    rng = np.random.default_rng(1)
    dx, root = rng.standard_normal(LAYOUT.size), rng.standard_normal((LAYOUT.size, LAYOUT.size))
    P = root @ root.T
    P = 0.5 * (P + P.T)
    M = np.eye(LAYOUT.size)
    M[:, 8] += turn(dx) - turn(np.zeros(LAYOUT.size))
    expected = M @ P @ M.T
    reduce_covariance(P, NOTHING, heading_coupling(dx, LAYOUT))
    np.testing.assert_allclose(P, expected, rtol=1e-10, atol=1e-10)
    np.testing.assert_array_equal(P, P.T)


def test_pings_and_inertial_samples_leave_an_unknown_heading_unknown():
    """After 60 noisy pings and 20 s of acceleration the standard deviation is still 3 deg, within a thousandth."""
    suite = SensorConfig.load("paper")
    rng = np.random.default_rng(2)
    belief = Belief.blank(LAYOUT, 0)
    sd = math.radians(3)
    belief.R = rotation(0.02, -0.03, 1.0)
    belief.P[3, 3] = belief.P[4, 4] = 0.1**2
    belief.P[6, 6] = belief.P[7, 7] = 1e-3**2
    write_prior(belief, CONFIG)
    belief.P += sd**2 * np.outer(turn(belief.x), turn(belief.x))
    filter_ = ErrorStateFilter(suite, CONFIG, belief)
    ranges = np.arange(1.0, 21.0)
    s = math.sin(suite.adcp.beam_angle_rad)
    for k in range(1, 2001):
        imu = ImuSample(
            t_ns=k * 10_000_000,
            interval_ns=10_000_000,
            angular_rate_radps=(0.0, 0.0, 0.02),
            specific_force_mps2=(0.02 * math.sin(0.005 * k), 0.02, -9.80665),
        )
        filter_.advance(imu.t_ns, imu)
        if k % 33 == 0:
            flow = 0.3 * s * np.array([1.0, -1.0, 0.5, -0.5])[:, None]
            z = flow + suite.adcp.beam_noise_sd_mps * rng.standard_normal((4, 20))
            filter_.correct(AdcpPing(t_ns=imu.t_ns, range_m=ranges, beam_velocity_mps=z))
    assert np.abs(belief.x[3:5]).max() > 0.05, "the estimate has moved, or nothing is tested"
    assert math.sqrt(belief.P[8, 8]) == pytest.approx(sd, rel=1e-3)
