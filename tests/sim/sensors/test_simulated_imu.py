"""The simulated inertial unit: signs by physics, integration back to the truth, noise and biases by statistics."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ltv_mpc import frames
from ltv_mpc.localisation.sensor_config import SensorConfig
from sim.attitude import Attitude
from sim.sensors.imu import InertialUnit, increments
from sim.sensors.simulated import GaussMarkovBias
from tests.sim.worlds import MS, check_white, instant

G = 9.80665
NO_EARTH = np.zeros(3)


def error_free(R1, v1, R2, v2, W=NO_EARTH, dt=0.01):
    return np.array(increments(R1, tuple(map(float, v1)), R2, tuple(map(float, v2)), W, dt))


@pytest.mark.parametrize(
    ("roll", "pitch", "force"),
    [
        (0.0, 0.0, [0.0, 0.0, -G]),
        (0.0, 0.1, [G * math.sin(0.1), 0, -G * math.cos(0.1)]),  # bow up: what holds it up points ahead too
        (0.1, 0.0, [0, -G * math.sin(0.1), -G * math.cos(0.1)]),  # starboard down: to port
    ],
)
def test_at_rest_the_specific_force_opposes_gravity(roll, pitch, force):
    R = frames.rotation(roll, pitch, 0.0)
    np.testing.assert_allclose(error_free(R, [0, 0, 0], R, [0, 0, 0]), [[0, 0, 0], force], atol=1e-15)


def test_in_a_turn_to_starboard_it_turns_about_down_and_is_pushed_to_starboard():
    r, V, dt = 0.1, 2.0, 0.01
    before, after = frames.rotation(0.0, 0.0, 0.0), frames.rotation(0.0, 0.0, r * dt)
    rate, force = error_free(before, [V, 0, 0], after, [V * math.cos(r * dt), V * math.sin(r * dt), 0])
    np.testing.assert_allclose(rate, [0, 0, r], atol=1e-12)
    np.testing.assert_allclose(force, [0, V * r, -G], atol=1e-6)


def test_moving_north_on_the_northern_hemisphere_needs_a_force_to_the_west():
    latitude = math.radians(50.0)
    W = frames.earth_rate(latitude)
    east = frames.rotation(0.0, 0.0, math.pi / 2)
    rate, _ = error_free(east, [0, 0, 0], east, [0, 0, 0], W)
    omega = 7.292115e-5
    # Heading east: north is to port, up is minus down.
    np.testing.assert_allclose(rate, [0.0, -omega * math.cos(latitude), -omega * math.sin(latitude)], atol=1e-12)
    _, force = error_free(np.eye(3), [3, 0, 0], np.eye(3), [3, 0, 0], W)
    assert force[1] == pytest.approx(-2 * omega * math.sin(latitude) * 3, rel=1e-3)
    _, force = error_free(np.eye(3), [0, 3, 0], np.eye(3), [0, 3, 0], W)
    assert force[2] + G == pytest.approx(2 * omega * math.cos(latitude) * 3, rel=1e-3)  # lighter on a way east
    assert force[0] == pytest.approx(2 * omega * math.sin(latitude) * 3, rel=1e-3)


def test_its_error_free_increments_integrate_back_to_the_truth_on_a_turning_earth():
    """Twenty seconds of tilt, turns and speed changes; the strapdown below is written with scipy's rotations."""
    tilt, dt, g, W = Attitude(0.05, 4.0, 3), 0.01, np.array([0.0, 0.0, G]), np.array([6e-5, 2e-5, 4e-5])
    times = np.arange(2001) * dt
    angles = [(*tilt.at(round(t * 1e9)), 0.8 * math.sin(0.2 * t)) for t in times]
    v = np.column_stack([0.5 * np.sin(0.3 * times), 0.3 * np.cos(0.2 * times), 0.2 * (1 - np.exp(-times))])
    R = [frames.rotation(*a) for a in angles]
    attitude, velocity = Rotation.from_matrix(R[0]), v[0]
    earth = Rotation.from_rotvec(-0.5 * dt * W)
    for k in range(1, len(times)):
        w, f = error_free(R[k - 1], v[k - 1], R[k], v[k], W, dt)
        half = Rotation.from_rotvec(0.5 * dt * w)
        middle = earth * attitude * half
        push = middle.apply(f) + g
        # 2 W x v with v at the middle, found in two rounds
        guess = velocity + dt * push
        for _ in range(2):
            guess = velocity + dt * (push - 2 * np.cross(W, 0.5 * (velocity + guess)))
        attitude, velocity = earth * middle * half, guess
    assert (attitude * Rotation.from_matrix(R[-1]).inv()).magnitude() < 1e-10
    np.testing.assert_allclose(velocity, v[-1], atol=1e-9)


def unit_record(imu, seed: int, samples: int) -> np.ndarray:
    """Return the errors of rate and force at rest, (samples, 6)."""
    unit = InertialUnit(imu, 0.0, seed)
    W = frames.earth_rate(0.0) if imu.senses_earth_rate else NO_EARTH
    assert unit.sample(instant(0)) == []
    rows = []
    for k in range(1, samples + 1):
        (sample,) = unit.sample(instant(10 * MS * k))
        assert (sample.t_ns, sample.interval_ns) == (10 * MS * k, 10 * MS)
        rows.append([*np.subtract(sample.angular_rate_radps, W), *np.add(sample.specific_force_mps2, [0.0, 0.0, G])])
    return np.array(rows)


ARW, VRW = math.radians(0.125) / 60.0, 3.3e-4


def test_noise_is_the_random_walk_over_the_root_of_the_interval_and_biases_have_the_tables_size():
    imu = SensorConfig.load("realistic").imu
    sizes = np.repeat([ARW, VRW], 3)
    rows = unit_record(imu, 5, 20_000) / (sizes / math.sqrt(0.01))
    check_white(np.diff(rows, axis=0)[::2] / math.sqrt(2.0), 1.0)  # the bias hardly moves in 10 ms
    # 1 deg/h and 1 mg; the mean of 50 samples adds the random walk's share
    means = np.array([unit_record(imu, seed, 50).mean(axis=0) for seed in range(200)])
    bias = np.repeat([math.radians(1.0) / 3600.0, 9.80665e-3], 3)
    check_white(means / np.hypot(bias, sizes / math.sqrt(0.5)), 1.0)


def test_a_drifting_bias_keeps_its_variance_and_decorrelates_with_its_time_constant():
    draws = np.random.default_rng(2)
    drift = GaussMarkovBias(0.3, 100.0, 20_000, draws)
    first = drift.value.copy()
    for _ in range(10):
        drift.advance(10.0)
    assert drift.value.std() == pytest.approx(0.3, rel=0.02)
    assert np.corrcoef(first, drift.value)[0, 1] == pytest.approx(math.exp(-1.0), abs=0.02)


def test_a_sample_has_its_own_interval_if_the_unit_is_slower_than_the_truth():
    unit = InertialUnit(SensorConfig.load("paper").imu, 0.0, 1)
    unit.sample(instant(0))
    (sample,) = unit.sample(instant(25 * MS))
    assert sample.interval_ns == 25 * MS
