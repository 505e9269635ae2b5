"""Error model of the bound: propagation and measurement rows against those of the filter, which shares none of them."""

import math

import numpy as np
import pytest

from ltv_mpc.frames import GRAVITY_MPS2, earth_rate, rotation, rotation_exp
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.filter.state import Belief, Layout
from ltv_mpc.localisation.filter.strapdown import imu_noise, integrate
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.sensors import BY_NAME
from ltv_mpc.localisation.sensors.sensor import Context
from ltv_mpc.messages import AdcpPing
from sim.evaluation.cramer_rao_bound.model import (
    ACCELEROMETER_BIAS,
    ATTITUDE,
    BEAM_BIAS,
    COMPASS_BIAS,
    GYRO_BIAS,
    MOUNTING,
    MOVING,
    NEAR_BIAS,
    POSITION,
    VELOCITY,
    WATER,
    ErrorModel,
    Instant,
)
from tests.ltv_mpc.localisation.sensors.every_sensor import dense, with_settings

PAPER, REALISTIC = SensorConfig.load("paper"), SensorConfig.load("realistic")


@pytest.mark.parametrize(("turning", "tolerance"), [(0.0, 2e-5), (1.0, 3e-3)], ids=["steady", "turning"])
def test_errors_grow_as_in_the_filter(turning, tolerance):
    """Over 200 samples of its strapdown integration, Earth rate and biases included.

    A vehicle that turns within the step is taken as one that has its mean attitude throughout: hence the tolerance.
    """
    suite = with_settings(REALISTIC, imu={"gyro_bias_tau_s": 1e9, "accelerometer_bias_tau_s": 1e9})
    W, dt = earth_rate(suite.latitude_rad), 1 / 3
    before = Instant(np.zeros(3), np.array([0.3, -0.2, 0.1]), rotation(0.03, -0.02, 0.8))
    rate = before.R.T @ W + turning * np.array([0.02, -0.01, 0.05])
    force = before.R.T @ np.array([0.2, -0.1, -GRAVITY_MPS2 + 0.05])
    x, R, transition, noise = np.zeros(15), before.R.copy(), np.eye(15), np.zeros((15, 15))
    x[VELOCITY] = before.v
    for _ in range(200):
        integrate(x, R, transition, noise, np.concatenate([rate, force]), dt / 200, imu_noise(suite.imu), W)
    Phi, _ = ErrorModel(suite, EstimatorConfig()).growth(before, Instant(x[POSITION], x[VELOCITY], R), dt)
    np.testing.assert_allclose(Phi[:9, :15], transition[:9], atol=tolerance)


def test_the_noise_of_a_step_is_what_many_small_steps_gather():
    """Q := Phi Q Phi^T + Q over 64 steps of 1/192 s is Q of the whole, and it is positive definite."""
    model = ErrorModel(REALISTIC, EstimatorConfig())
    first, change = Instant(np.zeros(3), np.zeros(3), rotation(0.1, 0.2, 0.3)), np.array([0.05, 0.0, 0.0])
    Phi, Q = model.growth(first, first._replace(v=change), 1 / 3)
    gathered, transition = np.zeros((MOVING, MOVING)), np.eye(MOVING)
    for k in range(64):
        a, b = (first._replace(v=change * i / 64) for i in (k, k + 1))
        phi, q = model.growth(a, b, 1 / 192)
        gathered, transition = phi @ gathered @ phi.T + q, phi @ transition
    np.testing.assert_allclose(transition, Phi, atol=1e-6)
    size = np.sqrt(np.outer(np.diag(Q), np.diag(Q)))
    np.testing.assert_allclose(gathered / size, Q / size, atol=1e-6)
    assert np.linalg.eigvalsh(Q / size)[0] > 0
    white = REALISTIC.imu.angle_random_walk_rad_per_rts**2 / 3  # one is known in closed form
    np.testing.assert_allclose(np.diag(Q)[6:9], white, rtol=1e-3)


def test_what_a_sensor_says_of_each_error_is_what_it_says_to_the_filter():
    """Rows of both, each divided by its standard deviation. The bound leaves out the turn of a lever arm."""
    config, lever = EstimatorConfig(deepest_m=20.0), (0.7, -0.4, -1.1)
    suite = with_settings(
        REALISTIC,
        adcp={"mounting_rad": (0.02, -0.03, 0.5), "range_m": 12.0},
        gnss={"lever_arm_m": lever},
        pressure={"lever_arm_m": lever},
    )
    model, layout = ErrorModel(suite, config), Layout.of(suite, config)
    water = 0.2 * np.random.default_rng(1).standard_normal((21, 2))
    now = Instant(np.array([3.0, 4.0, 5.3]), np.array([0.2, -0.3, 0.1]), rotation(0.2, -0.15, 1.0))
    belief = Belief.blank(layout, 0)
    belief.x[POSITION], belief.x[VELOCITY], belief.R = now
    belief.mounting = rotation(*suite.adcp.mounting_rad)
    belief.x[layout.north], belief.x[layout.east] = water.T
    states = np.full(layout.size, -1)  # of the model, by those of the filter
    for of_filter, of_model in (
        (slice(0, 15), slice(0, 15)),
        (layout.compass_bias, COMPASS_BIAS),
        (layout.beam_bias, BEAM_BIAS),
        (layout.near_bias, NEAR_BIAS),
        (layout.mounting, MOUNTING),
        (slice(layout.north.start, layout.east.stop), slice(WATER, model.size)),
    ):
        states[of_filter] = range(of_model.start, of_model.stop)
    beams = np.zeros((4, len(suite.adcp.cell_ranges_m)))
    ping = AdcpPing(t_ns=0, range_m=suite.adcp.cell_ranges_m, beam_velocity_mps=beams)
    used = math.sqrt((1 - suite.adcp.missing_share) * (1 - suite.adcp.outlier_share))
    for name, message, rows, weight in (
        ("gnss", BY_NAME["gnss"].at_rest(0, suite.gnss), model.gnss(now), 1.0),
        ("pressure", BY_NAME["pressure"].at_rest(0, suite.pressure), model.pressure(now, 3), math.sqrt(3)),
        ("compass", BY_NAME["compass"].at_rest(0, suite.compass), model.compass(now), 1.0),
        ("adcp", ping, model.adcp(now, water), used),
    ):
        context = Context(suite, config.cell_m, (0.0, 0.0, 0.0))
        seen = BY_NAME[name].linearise(belief, message, getattr(suite, name), context).rows
        expected = np.zeros_like(rows)
        H = weight * dense(seen, layout.size) / np.sqrt(seen.variance)[:, None]
        expected[:, states[states >= 0]] = H[:, states >= 0]
        expected[:, GYRO_BIAS] = 0.0
        np.testing.assert_allclose(rows, expected, rtol=1e-9, atol=1e-9, err_msg=name)


def test_levelling_says_what_the_assumed_attitude_makes_of_the_force_at_rest():
    """Reference: finite differences; the force is that of a vehicle at rest, bias included, and 0 if all is right."""
    config, R, g = EstimatorConfig(deepest_m=7.0), rotation(0.2, -0.15, 1.0), np.array([0.0, 0.0, GRAVITY_MPS2])
    white = REALISTIC.imu.velocity_random_walk_mps_per_rts**2 / 0.2
    sd = math.sqrt(white + config.afloat_acceleration_sd_mps2**2)

    def level(e):
        true = rotation_exp(e[ATTITUDE]) @ R
        return -(R @ (true.T @ -g + e[ACCELEROMETER_BIAS]))[:2]

    row = ErrorModel(REALISTIC, config).levelling(Instant(np.zeros(3), np.zeros(3), R))
    for j, e in enumerate(1e-6 * np.eye(MOVING)):
        np.testing.assert_allclose(row[:, j], (level(e) - level(-e)) / 2e-6 / sd, rtol=1e-6, atol=1e-6)


def test_biases_fade_and_are_drawn_anew_so_that_their_deviation_stays():
    """First-order Gauss-Markov, in closed form."""
    taus = {"gyro_bias_tau_s": 20.0, "accelerometer_bias_tau_s": 7.0}
    suite = with_settings(REALISTIC, imu=taus, compass={"bias_tau_s": 3.0})
    imu = suite.imu
    now = Instant(np.zeros(3), np.zeros(3), np.eye(3))
    Phi, Q = ErrorModel(suite, EstimatorConfig()).growth(now, now, 0.5)
    sd = np.repeat([imu.gyro_bias_sd_radps, imu.accelerometer_bias_sd_mps2, suite.compass.bias_sd_rad], [3, 3, 1])
    keep = np.exp(-0.5 / np.repeat([20.0, 7.0, 3.0], [3, 3, 1]))
    np.testing.assert_allclose(Phi[9:, 9:], np.diag(keep), atol=1e-12)
    np.testing.assert_allclose(np.diag(Q)[9:], sd**2 * (1 - keep**2), rtol=1e-9)


def test_what_is_assumed_at_first_is_what_the_estimator_assumes():
    """Sd of each node of the water and what two nodes have in common; 0.1 m/s of heave; biases by the sensors file."""
    config = EstimatorConfig(deepest_m=12.0)
    model = ErrorModel(PAPER, config)
    P = np.linalg.inv(model.prior()[WATER : WATER + 13, WATER : WATER + 13])
    mean, sd, length = config.current_mean_sd_mps, config.current_sd_mps, config.current_correlation_length_m
    np.testing.assert_allclose(np.diag(P), mean**2 + sd**2)
    np.testing.assert_allclose(P[2, 7], mean**2 + sd**2 * math.exp(-5 * config.cell_m / length))
    np.testing.assert_allclose(model.prior()[WATER:, WATER:][:13, 13:], 0)
    np.testing.assert_allclose(model.prior()[5, 5], 1 / 0.1**2)
    np.testing.assert_allclose(np.diag(model.prior())[GYRO_BIAS], 1 / PAPER.imu.gyro_bias_sd_radps**2)
