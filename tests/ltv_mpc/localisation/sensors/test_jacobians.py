"""Every partial derivative against central differences of its residual, over random beliefs of the fullest layout."""

import msgspec
import numpy as np
import pytest

from ltv_mpc.frames import rotation
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.filter.state import ATTITUDE, Belief, Layout
from ltv_mpc.localisation.sensors import BY_NAME, adcp, bottom_track, fitted, tdcp
from ltv_mpc.localisation.sensors.sensor import Context
from ltv_mpc.messages import AdcpPing, BottomTrack, TdcpFix
from tests.ltv_mpc.localisation.sensors.every_sensor import EVERY_SENSOR

SETTINGS = msgspec.structs.replace(
    EVERY_SENSOR,
    gnss=msgspec.structs.replace(EVERY_SENSOR.gnss, lever_arm_m=(0.7, -0.4, -1.1)),
    pressure=msgspec.structs.replace(EVERY_SENSOR.pressure, lever_arm_m=(-0.6, 0.3, 0.2)),
    lbl=msgspec.structs.replace(
        EVERY_SENSOR.lbl,
        transponders_m=((60.0, -20.0, 40.0),),
        sound_speed_sd_mps=3.0,
        outlier_m=10.0,
        lever_arm_m=(1.0, 0.5, 0.4),
    ),
    usbl=msgspec.structs.replace(
        EVERY_SENSOR.usbl, ship_m=(10.0, 20.0), bearing_sd_rad=0.01, outlier_m=30.0, lever_arm_m=(-0.8, 0.2, -0.3)
    ),
)
RATE = (0.3, -0.2, 0.1)
CONFIG = EstimatorConfig()
LAYOUT = Layout.of(SETTINGS, CONFIG)
CONTEXT = Context(SETTINGS, CONFIG.cell_m, RATE)


def random_belief(rng):
    belief = Belief.blank(LAYOUT, 0)
    belief.x = rng.standard_normal(LAYOUT.size)
    belief.x[ATTITUDE] = 0
    belief.x[LAYOUT.mounting] = 0
    belief.x[2] = 20.3
    belief.x[LAYOUT.sound_speed] = 0.01
    belief.R = rotation(*rng.uniform(-0.5, 0.5, 2), rng.uniform(-3, 3))
    belief.mounting = rotation(*rng.uniform(-0.1, 0.1, 3))
    return belief


def ping(rng):
    return AdcpPing(t_ns=0, range_m=1.4 + np.arange(15.0), beam_velocity_mps=rng.standard_normal((4, 15)))


LINEARISED = {
    "tdcp": lambda belief, _: tdcp.rows(
        belief, TdcpFix(t_ns=0, from_t_ns=0, north_m=1.0, east_m=2.0), SETTINGS.tdcp, SETTINGS.gnss.lever_arm_m
    ),
    "adcp": lambda belief, seen: adcp.linearise(belief, seen, SETTINGS.adcp, CONTEXT).rows,
    "bottom_track": lambda belief, seen: (
        bottom_track.linearise(
            belief,
            BottomTrack(t_ns=0, range_m=np.full(4, 9.0), beam_velocity_mps=seen.beam_velocity_mps[:, 0]),
            SETTINGS.bottom_track,
            CONTEXT,
        ).rows
    ),
}
"""Sensors with other messages than that of a vehicle at rest."""


def linearised(sensor, belief, seen):
    if sensor in LINEARISED:
        return LINEARISED[sensor](belief, seen)
    settings = getattr(SETTINGS, sensor)
    return BY_NAME[sensor].linearise(belief, BY_NAME[sensor].at_rest(0, settings), settings, CONTEXT).rows


@pytest.mark.parametrize("sensor", [sensor.name for sensor, _ in fitted(SETTINGS)])
@pytest.mark.parametrize("seed", range(3))
def test_partials_are_minus_the_derivatives_of_the_residual(sensor, seed):
    """1e-6 relative to the largest of a row; a residual is z - h, so its derivative is -H."""
    rng = np.random.default_rng(seed)
    belief, seen = random_belief(rng), ping(rng)
    H = linearised(sensor, belief, seen).dense(LAYOUT.size)
    h = 1e-5
    difference = np.empty_like(H)
    for k in range(LAYOUT.size):
        error = np.zeros(LAYOUT.size)
        error[k] = h
        up, down = belief.copy(), belief.copy()
        up.apply_error(error)
        down.apply_error(-error)
        difference[:, k] = (linearised(sensor, down, seen).residual - linearised(sensor, up, seen).residual) / (2 * h)
    scale = np.abs(difference).max(axis=1, keepdims=True)
    np.testing.assert_allclose(H / scale, difference / scale, atol=1e-6)
