"""Front or gyro test: detection of a continuing drift and of its cause."""

import numpy as np
import pytest

from ltv_mpc.frames import rotation
from ltv_mpc.localisation.adaptive.front_or_gyro_test import FrontOrGyroTest
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.filter.state import Belief, Layout
from ltv_mpc.localisation.sensor_config import SensorConfig

LAYOUT = Layout.of(SensorConfig.load("paper"), EstimatorConfig())
LEVEL = 2e-4


def followed(path, *, turning_radps=0.05, seconds=20.0):
    """Return the test after 20 s of pings of a turning vehicle; ``path`` (T,) to (T, 2) is the sum of corrections."""
    rng = np.random.default_rng(3)
    t = np.arange(0.0, seconds, 1 / 3)
    D = path(t, turning_radps) + 2e-3 * rng.standard_normal((len(t), 2))
    drift, belief = FrontOrGyroTest(), Belief.blank(LAYOUT, 0)
    for k in range(len(t)):
        belief.t_ns, belief.R = round(t[k] * 1e9), rotation(0.0, 0.0, turning_radps * t[k])
        drift.add(belief, D[k] - D[k - 1] if k else D[k])
    assert drift.duration_s == pytest.approx(t[-1])
    return drift


def front(t, _turning, *, ends_s=99.0):
    return np.outer(np.clip(t - 6.0, 0.0, ends_s - 6.0), [5e-3, -4e-3])


def gyro(t, turning):
    """30 deg/h about the body's y axis from 4 s on: phi' = R_y b, and v' = f x phi with f = -g down."""
    fine = np.arange(0.0, t[-1] + 0.01, 0.01)
    b = np.radians(30.0) / 3600.0 * (fine > 4.0)
    phi = 0.01 * np.cumsum(b[:, None] * np.stack([-np.sin(turning * fine), np.cos(turning * fine)], axis=1), axis=0)
    v = 0.01 * 9.81 * np.cumsum(np.stack([phi[:, 1], -phi[:, 0]], axis=1), axis=0)
    return np.stack([np.interp(t, fine, v[:, axis]) for axis in range(2)], axis=1)


@pytest.mark.parametrize("turning", [0.0, 0.05, -0.2])
def test_a_front_drifts_as_water_and_a_gyro_fault_as_a_tilt(turning):
    water, unit = followed(front, turning_radps=turning), followed(gyro, turning_radps=turning)
    assert water.is_drifting(LEVEL)
    assert not water.is_gyro_fault()
    assert unit.is_drifting(LEVEL)
    assert unit.is_gyro_fault()


def test_no_drift_after_a_front_or_within_the_level_error():
    assert not followed(lambda t, turning: front(t, turning, ends_s=14.0)).is_drifting(LEVEL)
    assert not followed(front).is_drifting(5 * LEVEL)
    assert not followed(front, seconds=0.9).is_drifting(0.0)
