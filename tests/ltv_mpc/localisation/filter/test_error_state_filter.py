"""Error-state filter: propagation of its covariance, and the outcomes of measurements."""

import math

import msgspec
import numpy as np
import pytest
from scipy.special import chdtri

from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.filter.error_state_filter import ErrorStateFilter
from ltv_mpc.localisation.filter.state import Belief, Layout
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.messages import AdcpPing, CompassHeading, ImuSample, PressureDepth, TdcpFix

PAPER = SensorConfig.load("paper")
DT_NS = 10_000_000
CONFIG = msgspec.structs.replace(EstimatorConfig(), deepest_m=12.0, gate_probability=1.0)  # every innovation passes


def sample(k, force=(0.0, 0.0, -9.80665), rate=(0.0, 0.0, 0.0)):
    return ImuSample(t_ns=k * DT_NS, interval_ns=DT_NS, angular_rate_radps=rate, specific_force_mps2=force)


def full_belief(suite, config, seed=0):
    rng = np.random.default_rng(seed)
    layout = Layout.of(suite, config)
    belief = Belief.blank(layout, 0)
    root = rng.standard_normal((layout.size, layout.size)) / layout.size
    belief.P = root @ root.T
    belief.x[layout.compass_bias] = 0.02
    return belief


def test_propagating_the_covariance_once_equals_doing_it_at_every_sample():
    suite = SensorConfig.load("realistic")
    config = msgspec.structs.replace(CONFIG, current_change_mps_per_rts=0.01)
    rng = np.random.default_rng(4)
    once, always = (ErrorStateFilter(suite, config, full_belief(suite, config)) for _ in range(2))
    for k in range(1, 34):
        imu = sample(k, tuple((np.array([0.1, 0.2, -9.7]) + rng.standard_normal(3)).tolist()), (0.1, -0.2, 0.3))
        once.advance(k * DT_NS, imu)
        always.advance(k * DT_NS, imu)
        always.propagate_covariance()
    np.testing.assert_allclose(once.core_covariance(), always.belief.P[:15, :15], rtol=1e-10, atol=1e-16)
    before = np.diag(once.belief.P).copy()
    once.propagate_covariance()
    water = slice(once.belief.layout.north.start, once.belief.layout.east.stop)
    np.testing.assert_allclose((np.diag(once.belief.P) - before)[water], 0.01**2 * 0.33)  # the walk of the water
    np.testing.assert_allclose(once.belief.P, always.belief.P, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(once.belief.x, always.belief.x, rtol=1e-13)
    np.testing.assert_array_equal(once.belief.P, once.belief.P.T)


def test_a_compass_bias_keeps_its_deviation_and_forgets_its_value():
    suite = SensorConfig.load("realistic")
    belief = full_belief(suite, CONFIG)
    bias = belief.layout.compass_bias.start
    belief.P[bias, bias] = suite.compass.bias_sd_rad**2
    constant = belief.layout.beam_bias.start
    cross = belief.P[constant, bias]
    filter_ = ErrorStateFilter(suite, CONFIG, belief)
    filter_.advance(1_000 * DT_NS, sample(1_000))
    filter_.propagate_covariance()
    keep = math.exp(-10.0 / suite.compass.bias_tau_s)
    assert belief.P[bias, bias] == pytest.approx(suite.compass.bias_sd_rad**2, rel=1e-12)
    assert belief.x[bias] == pytest.approx(0.02 * keep, rel=1e-12)
    assert belief.P[constant, bias] == belief.P[bias, constant] == pytest.approx(keep * cross, rel=1e-12)


def test_every_scalar_measurement_is_counted_by_its_outcome():
    suite = SensorConfig.load("realistic")
    belief = Belief.blank(Layout.of(suite, EstimatorConfig()), 0)
    belief.P += 1e-4 * np.eye(belief.layout.size)
    belief.x[2] = 65.0
    filter_ = ErrorStateFilter(suite, EstimatorConfig(), belief)
    z = np.zeros((4, 8))
    z[0, 0] = 5.0
    z[1, 1] = np.nan
    filter_.correct(AdcpPing(t_ns=0, range_m=np.arange(1.0, 9.0), beam_velocity_mps=z))
    filter_.correct(PressureDepth(t_ns=0, depth_m=80.0))
    filter_.correct(CompassHeading(t_ns=0, heading_rad=0.0))
    filter_.correct(TdcpFix(t_ns=0, from_t_ns=-1, north_m=0.0, east_m=0.0))
    account = filter_.account
    assert account["adcp.no_return"] == 1
    assert account["adcp.gate"] == 1
    assert account["adcp.outside_grid"] == 4 * 3  # 65.3 + r cos 20 deg > 70 for r = 6, 7, 8
    assert account["adcp.used"] + account["adcp.gate"] + account["adcp.no_return"] + account["adcp.outside_grid"] == 32
    assert (account["pressure.gate"], account["compass.used"], account["tdcp.other_epoch"]) == (1, 1, 2)


def test_a_satellite_fix_just_beyond_the_gate_is_de_weighted_a_pressure_rejected():
    """Four deviations of innovation, which the gate of 3.3 holds back; and seven."""
    belief = Belief.blank(Layout.of(PAPER, EstimatorConfig()), 0)
    belief.P += 1e-4 * np.eye(belief.layout.size)
    filter_ = ErrorStateFilter(PAPER, EstimatorConfig(), belief)
    sd = math.hypot(PAPER.tdcp.displacement_sd_m, math.sqrt(2e-4))  # of position and of its clone
    filter_.correct(TdcpFix(t_ns=0, from_t_ns=0, north_m=4.0 * sd, east_m=7.0 * sd))
    assert (filter_.account["tdcp.used"], filter_.account["tdcp.deweighted"], filter_.account["tdcp.gate"]) == (1, 1, 1)
    assert belief.x[0] == pytest.approx(1e-4 * 4.0 * sd / (sd * sd * 16.0 / chdtri(1, 0.001)))
    assert belief.x[1] == 0.0
    filter_.correct(PressureDepth(t_ns=0, depth_m=4.0 * math.hypot(PAPER.pressure.depth_sd_m, 0.01)))
    assert (filter_.account["pressure.used"], filter_.account["pressure.gate"]) == (0, 1)
