"""Every partial derivative against central differences of its residual, over random beliefs of the fullest layout."""

import numpy as np
import pytest

from ltv_mpc.frames import rotation
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.filter.state import ATTITUDE, Belief, Layout
from ltv_mpc.localisation.sensors import BY_NAME, fitted
from ltv_mpc.localisation.sensors.sensor import Context
from ltv_mpc.messages import AdcpPing, BottomTrack, TdcpFix
from tests.ltv_mpc.localisation.sensors.every_sensor import EVERY_SENSOR, with_settings

SENSORS = with_settings(
    EVERY_SENSOR,
    gnss={"lever_arm_m": (0.7, -0.4, -1.1)},
    pressure={"lever_arm_m": (-0.6, 0.3, 0.2)},
    lbl={
        "transponders_m": ((60.0, -20.0, 40.0),),
        "sound_speed_sd_mps": 3.0,
        "outlier_m": 10.0,
        "lever_arm_m": (1.0, 0.5, 0.4),
    },
    usbl={"ship_m": (10.0, 20.0), "bearing_sd_rad": 0.01, "outlier_m": 30.0, "lever_arm_m": (-0.8, 0.2, -0.3)},
)
CONFIG = EstimatorConfig()
LAYOUT = Layout.of(SENSORS, CONFIG)
CONTEXT = Context(SENSORS, CONFIG.cell_m, (0.3, -0.2, 0.1))


def random_belief(rng):
    belief = Belief.blank(LAYOUT, 0)
    belief.x = rng.standard_normal(LAYOUT.size)
    belief.x[ATTITUDE] = belief.x[LAYOUT.mounting] = 0
    belief.x[2] = 20.3
    belief.x[LAYOUT.sound_speed] = 0.01
    belief.R = rotation(*rng.uniform(-0.5, 0.5, 2), rng.uniform(-3, 3))
    belief.mounting = rotation(*rng.uniform(-0.1, 0.1, 3))
    return belief


def message(sensor, rng):
    """Return a random message of a sensor, or that of a vehicle at rest."""
    z = rng.standard_normal((4, 15))
    match sensor:
        case "adcp":
            return AdcpPing(t_ns=0, range_m=1.4 + np.arange(15.0), beam_velocity_mps=z)
        case "bottom_track":
            return BottomTrack(t_ns=0, range_m=np.full(4, 9.0), beam_velocity_mps=z[:, 0])
        case "tdcp":
            return TdcpFix(t_ns=0, from_t_ns=0, north_m=1.0, east_m=2.0)
        case _:
            return BY_NAME[sensor].at_rest(0, getattr(SENSORS, sensor))


@pytest.mark.parametrize("sensor", [sensor.name for sensor, _ in fitted(SENSORS)])
def test_partials_are_minus_the_derivatives_of_the_residual(sensor):
    """1e-6 relative to the largest of a row; a residual is z - h, so its derivative is -H."""
    rng = np.random.default_rng(0)
    belief, measured, settings = random_belief(rng), message(sensor, rng), getattr(SENSORS, sensor)

    def rows(at):
        return BY_NAME[sensor].linearise(at, measured, settings, CONTEXT).rows

    H, h = rows(belief).times(np.eye(LAYOUT.size)), 1e-5
    difference = np.empty_like(H)
    for k, error in enumerate(h * np.eye(LAYOUT.size)):
        up, down = belief.copy(), belief.copy()
        up.apply_error(error)
        down.apply_error(-error)
        difference[:, k] = (rows(down).residual - rows(up).residual) / (2 * h)
    scale = np.abs(difference).max(axis=1, keepdims=True)
    np.testing.assert_allclose(H / scale, difference / scale, atol=1e-6)
