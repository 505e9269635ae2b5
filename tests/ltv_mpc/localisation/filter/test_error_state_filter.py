"""Error-state filter on linear problems, against a batch least-squares solution over all unknowns."""

import math

import msgspec
import numpy as np
import pytest
from scipy.special import chdtri

from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.filter.error_state_filter import ErrorStateFilter
from ltv_mpc.localisation.filter.state import Belief, Layout
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.sensors.adcp import beam_directions
from ltv_mpc.localisation.water.current_model import node_prior
from ltv_mpc.messages import AdcpPing, CompassHeading, ImuSample, PressureDepth, TdcpFix
from tests.ltv_mpc.localisation.sensors.every_sensor import with_settings

PAPER = SensorConfig.load("paper")
DT = 0.01
DT_NS = 10_000_000
CONFIG = msgspec.structs.replace(EstimatorConfig(), deepest_m=12.0, gate_probability=1.0)  # every innovation passes
CELLS = 13


def sample(k, force=(0.0, 0.0, -9.80665), rate=(0.0, 0.0, 0.0)):
    return ImuSample(t_ns=k * DT_NS, interval_ns=DT_NS, angular_rate_radps=rate, specific_force_mps2=force)


def batch(unknowns, rows, right, sd):
    """Return the least-squares solution of whitened rows and its covariance."""
    A = np.array(rows) / np.array(sd)[:, None]
    solution = np.linalg.lstsq(A, np.array(right) / np.array(sd), rcond=None)[0]
    assert A.shape[1] == unknowns
    return solution, np.linalg.inv(A.T @ A)


def test_profiles_of_water_are_weighted_as_least_squares_does():
    """Level, depth and attitude known, sinking through cells that walk in time.

    Unknowns: velocity north and east, each beam's bias, the cells at the start and each of their steps.
    """
    walk = 0.02
    config = msgspec.structs.replace(CONFIG, current_change_mps_per_rts=walk, adapts_to_water=False)
    errors = "gyro_bias_sd_radps", "angle_random_walk_rad_per_rts", "velocity_random_walk_mps_per_rts"
    perfect = dict.fromkeys((*errors, "accelerometer_bias_sd_mps2"), 0.0)
    suite = with_settings(PAPER, imu=perfect, adcp={"beam_bias_sd_mps": 0.03})
    layout = Layout.of(suite, config)
    belief = Belief.blank(layout, 0)
    sd_v, sinking = 0.3, 0.5
    belief.P[3, 3] = belief.P[4, 4] = sd_v**2
    belief.x[5] = sinking
    belief.P[layout.beam_bias, layout.beam_bias] = 0.03**2 * np.eye(4)
    prior = node_prior(config).covariance(slice(None))
    for axis in (layout.north, layout.east):
        belief.P[axis, axis] = prior
    filter_ = ErrorStateFilter(suite, config, belief)

    rng = np.random.default_rng(1)
    pings, between = 8, 25
    unknowns = 2 + 4 + 2 * CELLS * (1 + pings)
    eye = np.eye(unknowns)
    rows, right, sds = [*eye[:2], *eye[2:6]], [0.0] * 6, [sd_v] * 2 + [0.03] * 4
    white = np.linalg.inv(np.linalg.cholesky(prior))
    for axis in range(2):
        first = 6 + axis * CELLS
        rows += list(white @ eye[first : first + CELLS])
        right += [0.0] * CELLS
        sds += [1.0] * CELLS
    cells = eye[6 : 6 + 2 * CELLS].copy()
    beams, ranges = beam_directions(math.radians(20)), np.arange(1.0, 6.0)
    for i in range(pings):
        for k in range(i * between + 1, (i + 1) * between + 1):
            filter_.advance(k * DT_NS, sample(k))
        steps = eye[6 + 2 * CELLS * (1 + i) : 6 + 2 * CELLS * (2 + i)]
        cells = cells + steps
        rows += list(steps)
        right += [0.0] * len(steps)
        sds += [walk * math.sqrt(between * DT)] * len(steps)
        z = 0.3 * rng.standard_normal((4, 5))
        filter_.correct(AdcpPing(t_ns=(i + 1) * between * DT_NS, range_m=ranges, beam_velocity_mps=z))
        depth = sinking * (i + 1) * between * DT
        for beam in range(4):
            for j, r in enumerate(ranges):
                at = depth + r * beams[beam, 2]
                k, t = int(at), at - int(at)
                row = eye[2 + beam].copy()
                for axis in range(2):
                    water = (1 - t) * cells[axis * CELLS + k] + t * cells[axis * CELLS + k + 1]
                    row += beams[beam, axis] * (water - eye[axis])
                rows.append(row)
                right.append(z[beam, j] + beams[beam, 2] * sinking)
                sds.append(suite.adcp.beam_noise_sd_mps)
    solution, covariance = batch(unknowns, rows, right, sds)
    T = np.concatenate([eye[:2], eye[2:6], cells])
    at = [3, 4, *range(layout.beam_bias.start, layout.beam_bias.stop), *range(layout.north.start, layout.east.stop)]
    np.testing.assert_allclose(filter_.belief.x[at], T @ solution, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(filter_.belief.P[np.ix_(at, at)], T @ covariance @ T.T, rtol=1e-8, atol=1e-12)


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
    once.propagate_covariance()
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
