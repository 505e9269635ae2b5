"""Points away from the origin: partials against differences, and the clone of an antenna's position."""

import numpy as np
import pytest

from ltv_mpc.frames import rotation
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.filter.state import ATTITUDE, GYRO_BIAS, Belief, Layout
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.sensors import lever_arm

LAYOUT = Layout.of(SensorConfig.load("realistic"), EstimatorConfig())
LEVER = (2.0, -0.7, -3.0)
RATE = (0.3, -0.2, 0.4)


@pytest.fixture
def belief():
    belief = Belief.blank(LAYOUT, 0)
    rng = np.random.default_rng(5)
    belief.x = 0.1 * rng.standard_normal(LAYOUT.size)
    belief.R = rotation(0.3, -0.2, 2.5)
    root = rng.standard_normal((LAYOUT.size, LAYOUT.size)) / LAYOUT.size
    belief.P = root @ root.T
    return belief


def moved(belief, k, by):
    error = np.zeros(LAYOUT.size)
    error[k] = by
    other = belief.copy()
    other.apply_error(error)
    return other


def differences(belief, function, h=1e-6):
    return np.stack(
        [(function(moved(belief, k, h)) - function(moved(belief, k, -h))) / (2 * h) for k in range(LAYOUT.size)], axis=1
    )


def test_partials_of_a_point_and_its_swing_are_differences(belief):
    D = differences(belief, lambda b: lever_arm.point(b, LEVER).offset)
    np.testing.assert_allclose(D[:, ATTITUDE], lever_arm.point(belief, LEVER).by_attitude, atol=1e-8)
    D = differences(belief, lambda b: lever_arm.swing(b, LEVER, RATE).velocity)
    swing = lever_arm.swing(belief, LEVER, RATE)
    np.testing.assert_allclose(D[:, ATTITUDE], swing.by_attitude, atol=1e-8)
    np.testing.assert_allclose(D[:, GYRO_BIAS], swing.by_gyro_bias, atol=1e-8)


def test_a_cloned_antenna_has_the_errors_of_position_and_attitude(belief):
    """P := T P T^T with the clone's rows of T by differences of p + R l."""
    T = np.eye(LAYOUT.size)
    T[LAYOUT.epoch] = differences(belief, lambda b: b.x[:2] + lever_arm.point(b, LEVER).offset[:2])
    P = belief.P.copy()
    place = belief.x[:2] + (belief.R @ np.array(LEVER))[:2]
    belief.clone_position(LEVER)
    np.testing.assert_allclose(belief.P, T @ P @ T.T, atol=1e-10)
    np.testing.assert_array_equal(belief.P, belief.P.T)
    np.testing.assert_allclose(belief.x[LAYOUT.epoch], place)
