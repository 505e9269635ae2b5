"""Error model of the bound: propagation and measurement rows against independent computations."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ltv_mpc.frames import GRAVITY_MPS2, earth_rate, rotation, rotation_exp
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.sensors.adcp import beam_directions
from sim.evaluation.cramer_rao_bound.model import (
    ACCELEROMETER_BIAS,
    ATTITUDE,
    BEAM_BIAS,
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
from sim.sensors.adcp import beam_velocities
from sim.sensors.vehicle_state import VehicleState
from sim.water.column import WaterSample
from tests.ltv_mpc.localisation.sensors.every_sensor import with_settings

PAPER, REALISTIC = SensorConfig.load("paper"), SensorConfig.load("realistic")


def strapdown(p, v, R, gyro_bias, accelerometer_bias, rate, force, W, dt, steps):
    """Integrate the navigation equations in NED by small Euler steps from IMU measurements."""
    h = dt / steps
    g = np.array([0.0, 0.0, GRAVITY_MPS2])
    for _ in range(steps):
        w, f = rate - gyro_bias, force - accelerometer_bias
        middle = rotation_exp(-W * h / 2) @ R @ rotation_exp(w * h / 2)
        a = middle @ f + g - 2 * np.cross(W, v)
        p, v, R = p + h * v + h * h / 2 * a, v + h * a, rotation_exp(-W * h) @ R @ rotation_exp(w * h)
    return p, v, R


@pytest.mark.parametrize(("turning", "tolerance"), [(0.0, 2e-5), (1.0, 3e-3)], ids=["steady", "turning"])
def test_errors_grow_as_two_integrations_of_the_same_samples_part(turning, tolerance):
    """Phi by finite differences of the nonlinear equations, Earth rate and biases included.

    A vehicle that turns within the step is taken as one that has its mean attitude throughout: hence the tolerance.
    """
    suite = with_settings(REALISTIC, imu={"gyro_bias_tau_s": 1e9, "accelerometer_bias_tau_s": 1e9})
    W, dt, steps = earth_rate(suite.latitude_rad), 1 / 3, 200
    p0, v0, R0 = np.zeros(3), np.array([0.3, -0.2, 0.1]), rotation(0.03, -0.02, 0.8)
    rate = R0.T @ W + turning * np.array([0.02, -0.01, 0.05])
    force = R0.T @ np.array([0.2, -0.1, -GRAVITY_MPS2 + 0.05])

    def end(e):
        """Return the truth if the estimate is the one below and its error is e."""
        R = rotation_exp(e[ATTITUDE]) @ R0
        p, v, R = strapdown(p0 + e[:3], v0 + e[3:6], R, e[GYRO_BIAS], e[ACCELEROMETER_BIAS], rate, force, W, dt, steps)
        return p, v, R

    p, v, R = end(np.zeros(15))
    Phi, _ = ErrorModel(suite, EstimatorConfig()).growth(Instant(p0, v0, R0), Instant(p, v, R), dt)
    for j in range(15):
        e = np.zeros(15)
        e[j] = 1e-5
        p2, v2, R2 = end(e)
        got = np.concatenate([p2 - p, v2 - v, Rotation.from_matrix(R2 @ R.T).as_rotvec()]) / 1e-5
        np.testing.assert_allclose(Phi[:9, j], got, atol=tolerance, err_msg=str(j))


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


def test_what_a_ping_says_of_each_error_is_the_change_of_the_simulated_beams():
    """Reference: finite differences of the simulation; beam and range biases from the sensor configuration."""
    config = EstimatorConfig(deepest_m=20.0)
    suite = with_settings(REALISTIC, adcp={"mounting_rad": (0.02, -0.03, 0.5), "range_m": 12.0})
    adcp = suite.adcp
    rng = np.random.default_rng(1)
    depths = np.arange(21.0)
    water = 0.2 * rng.standard_normal((21, 2))
    p, v, R = np.array([3.0, 4.0, 5.3]), np.array([0.2, -0.3, 0.1]), rotation(0.05, -0.04, 1.0)
    ranges = adcp.blanking_m + 0.5 + np.arange(11.0)

    def simulated(e):
        M = rotation_exp(e[MOUNTING]) @ rotation(*adcp.mounting_rad)
        column = water + np.column_stack([e[WATER : WATER + 21], e[WATER + 21 :]])
        turned = rotation_exp(e[ATTITUDE]) @ R
        now = VehicleState(0, tuple(p + e[POSITION]), tuple(v + e[VELOCITY]), turned, lambda: np.zeros(3), 0.0)
        beams = beam_directions(adcp.beam_angle_rad) @ M.T
        b = beam_velocities(now, adcp.lever_arm_m, beams, ranges, WaterSample(depths, column, column, 0.0))
        biases = e[BEAM_BIAS][:, None] + e[NEAR_BIAS][:, None] * np.exp(-ranges / adcp.near_bias_length_m)
        return (b + biases).ravel()

    model = ErrorModel(suite, config)
    rows = model.adcp(Instant(p, v, R), water)
    rows *= adcp.beam_noise_sd_mps / math.sqrt((1 - adcp.missing_share) * (1 - adcp.outlier_share))
    h = 1e-6
    for j in range(model.size):
        e = np.zeros(model.size)
        e[j] = h
        got = (simulated(e) - simulated(-e)) / (2 * h)
        np.testing.assert_allclose(rows[:, j], got, atol=1e-7, err_msg=str(j))


def test_what_other_sensors_say_of_each_error_is_the_change_of_what_they_measure():
    """Reference: finite differences of antenna, gauge, heading with bias, and levelling."""
    lever = (0.7, -0.4, -1.1)
    suite = with_settings(REALISTIC, gnss={"lever_arm_m": lever}, pressure={"lever_arm_m": lever})
    config = EstimatorConfig(deepest_m=7.0)
    model = ErrorModel(suite, config)
    p, v, R = np.array([3.0, 4.0, 5.0]), np.array([0.2, -0.3, 0.1]), rotation(0.2, -0.15, 1.0)
    g = np.array([0.0, 0.0, GRAVITY_MPS2])

    def measured(e):
        true = rotation_exp(e[ATTITUDE]) @ R
        place = p + e[POSITION] + true @ lever
        # what the assumed attitude makes of the force that a vehicle at rest feels, bias included; 0 if all is right
        level = -(R @ (true.T @ -g + e[ACCELEROMETER_BIAS]))
        return {
            "gnss": [*place[:2], *(v + e[VELOCITY])[:2]],
            "pressure": [place[2]],
            "compass": [math.atan2(true[1, 0], true[0, 0]) + e[15]],
            "levelling": level[:2],
        }

    now = Instant(p, v, R)
    white = suite.imu.velocity_random_walk_mps_per_rts**2 / 0.2
    sd = {
        "gnss": np.repeat([suite.gnss.position_sd_m, suite.gnss.velocity_sd_mps], 2),
        "pressure": suite.pressure.depth_sd_m / math.sqrt(3),
        "compass": suite.compass.heading_sd_rad,
        "levelling": math.sqrt(white + config.afloat_acceleration_sd_mps2**2),
    }
    rows = {"gnss": model.gnss(now), "pressure": model.pressure(now, 3)}
    rows |= {"compass": model.compass(now), "levelling": model.levelling(now)}
    h = 1e-6
    for j in range(MOVING):
        e = np.zeros(model.size)
        e[j] = h
        up, down = measured(e), measured(-e)
        for name, row in rows.items():
            got = (np.array(up[name]) - np.array(down[name])) / (2 * h) / sd[name]
            np.testing.assert_allclose(row[:, j], got, rtol=1e-6, atol=1e-6, err_msg=f"{name} {j}")


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


def test_a_heading_turned_with_everything_else_changes_no_beam():
    """phi_d = 1, dv = z x v, dc = z x c: what profiler and inertial unit cannot see is not in the information."""
    model = ErrorModel(REALISTIC, EstimatorConfig(deepest_m=20.0))
    rng = np.random.default_rng(2)
    water, v = 0.2 * rng.standard_normal((21, 2)), np.array([0.3, -0.2, 0.1])
    together = np.zeros(model.size)
    together[8], together[3], together[4] = 1.0, -v[1], v[0]
    together[WATER : WATER + 21], together[WATER + 21 :] = -water[:, 1], water[:, 0]
    rows = model.adcp(Instant(np.array([0, 0, 2.0]), v, rotation(0.1, -0.1, 0.4)), water)
    np.testing.assert_allclose(rows @ together, 0, atol=1e-9)
