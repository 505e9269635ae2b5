"""Error-state filter on linear problems, against a batch least-squares solution over all unknowns."""

import math

import msgspec
import numpy as np
import pytest
from scipy.special import chdtri

from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.filter.error_state_filter import ErrorStateFilter
from ltv_mpc.localisation.filter.state import ACCELEROMETER_BIAS, Belief, Layout
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.water.current_model import node_prior
from ltv_mpc.messages import AdcpPing, CompassHeading, GnssFix, ImuSample, PressureDepth, TdcpFix

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


def test_inertial_and_satellite_measurements_are_weighted_as_least_squares_does():
    """Level, attitude known. Unknowns along one axis: p0, v0, b0 and each sample's velocity noise and bias step.

    v[k+1] = v[k] + dt (f[k] - b[k]) + w[k],  p[k+1] = p[k] + dt (v[k] + v[k+1]) / 2,  b[k+1] = a b[k] + d[k]
    """
    imu = msgspec.structs.replace(
        PAPER.imu, gyro_bias_sd_radps=0.0, angle_random_walk_rad_per_rts=0.0, accelerometer_bias_tau_s=0.4
    )
    suite = msgspec.structs.replace(
        PAPER,
        imu=msgspec.structs.replace(imu, velocity_random_walk_mps_per_rts=0.05, accelerometer_bias_sd_mps2=0.2),
        gnss=msgspec.structs.replace(PAPER.gnss, position_sd_m=0.5, velocity_sd_mps=0.1),
        tdcp=msgspec.structs.replace(PAPER.tdcp, displacement_sd_m=0.01),
    )
    rng = np.random.default_rng(0)
    steps, sd0 = 100, np.array([2.0, 0.7, 0.2])
    layout = Layout.of(suite, CONFIG)
    belief = Belief.blank(layout, 0)
    for i, sd in enumerate(sd0):
        belief.P[3 * i if i < 2 else 12, 3 * i if i < 2 else 12] = sd**2
    belief.clone_position()
    filter_ = ErrorStateFilter(suite, CONFIG, belief)

    a = math.exp(-DT / 0.4)
    unknowns = 3 + 2 * steps
    rows, right, sds = [], [], []

    def add(row, value, sd):
        rows.append(row)
        right.append(value)
        sds.append(sd)

    # p, v, b as rows over the unknowns, and their parts that the measured force determines
    p, v, b = (np.eye(unknowns)[i] for i in range(3))
    p_known = v_known = 0.0
    for i in range(3):
        add(np.eye(unknowns)[i], 0.0, sd0[i])
    epoch, epoch_known, epoch_ns = p.copy(), 0.0, 0
    for k in range(1, steps + 1):
        f = rng.standard_normal()
        filter_.advance(k * DT_NS, sample(k, (f, 0.0, -9.80665)))
        w, d = np.eye(unknowns)[1 + 2 * k], np.eye(unknowns)[2 + 2 * k]
        add(w, 0.0, 0.05 * math.sqrt(DT))
        add(d, 0.0, 0.2 * math.sqrt(1 - a * a))
        v_new, v_new_known = v - DT * b + w, v_known + DT * f
        p, p_known = p + 0.5 * DT * (v + v_new), p_known + 0.5 * DT * (v_known + v_new_known)
        v, v_known, b = v_new, v_new_known, a * b + d
        if k % 20 == 0:
            z = rng.standard_normal(3)
            fix = GnssFix(
                t_ns=k * DT_NS, north_m=float(z[0]), east_m=0.0, velocity_north_mps=float(z[1]), velocity_east_mps=0.0
            )
            step = TdcpFix(t_ns=k * DT_NS, from_t_ns=epoch_ns, north_m=float(0.1 * z[2]), east_m=0.0)
            # whichever comes first, the change of position is taken from the epoch before
            for message in (fix, step) if k % 40 == 0 else (step, fix):
                filter_.correct(message)
            add(p, z[0] - p_known, 0.5)
            add(v, z[1] - v_known, 0.1)
            add(p - epoch, 0.1 * z[2] - (p_known - epoch_known), 0.01)
            epoch, epoch_known, epoch_ns = p.copy(), p_known, k * DT_NS
    assert filter_.account["tdcp.used"] == 10
    solution, covariance = batch(unknowns, rows, right, sds)
    x, P = filter_.belief.x, filter_.belief.P
    expected = np.array([p @ solution + p_known, v @ solution + v_known, b @ solution])
    T = np.array([p, v, b])
    at = [0, 3, ACCELEROMETER_BIAS.start]
    np.testing.assert_allclose(x[at], expected, rtol=1e-8)
    np.testing.assert_allclose(P[np.ix_(at, at)], T @ covariance @ T.T, rtol=1e-8)


def test_profiles_of_water_are_weighted_as_least_squares_does():
    """Level, depth and attitude known, sinking through cells that walk in time.

    Unknowns: velocity north and east, each beam's bias, the cells at the start and each of their steps.
    """
    walk = 0.02
    config = msgspec.structs.replace(CONFIG, current_change_mps_per_rts=walk, adapts_to_water=False)
    imu = msgspec.structs.replace(
        PAPER.imu,
        gyro_bias_sd_radps=0.0,
        angle_random_walk_rad_per_rts=0.0,
        velocity_random_walk_mps_per_rts=0.0,
        accelerometer_bias_sd_mps2=0.0,
    )
    adcp = msgspec.structs.replace(PAPER.adcp, beam_bias_sd_mps=0.03)
    suite = msgspec.structs.replace(PAPER, imu=imu, adcp=adcp)
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
    s, c = math.sin(math.radians(20)), math.cos(math.radians(20))
    beams = np.array([[s, 0, c], [-s, 0, c], [0, s, c], [0, -s, c]])
    ranges = np.arange(1.0, 6.0)
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
                at = depth + r * c
                k, t = int(at), at - int(at)
                row = eye[2 + beam].copy()
                for axis in range(2):
                    water = (1 - t) * cells[axis * CELLS + k] + t * cells[axis * CELLS + k + 1]
                    row += beams[beam, axis] * (water - eye[axis])
                rows.append(row)
                right.append(z[beam, j] + beams[beam, 2] * sinking)
                sds.append(adcp.beam_noise_sd_mps)
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
