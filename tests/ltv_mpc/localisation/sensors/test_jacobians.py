"""Every partial derivative against central differences of its residual, over random beliefs of the fullest layout."""

import msgspec
import numpy as np
import pytest

from ltv_mpc.frames import rotation
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.filter.state import ATTITUDE, Belief, Layout
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.sensors import adcp, bottom_track, compass, gnss, lbl, pressure, tdcp, usbl
from ltv_mpc.localisation.sensors.bottom_track import BottomTracking
from ltv_mpc.localisation.sensors.lbl import Lbl
from ltv_mpc.localisation.sensors.sensor import Context
from ltv_mpc.localisation.sensors.usbl import Usbl
from ltv_mpc.messages import (
    AdcpPing,
    BottomTrack,
    CompassHeading,
    GnssFix,
    LblRange,
    PressureDepth,
    TdcpFix,
    UsblFix,
)

REALISTIC = SensorConfig.load("realistic")
ODD = {"period_ns": 1_000_000_000, "missing_share": 0.0, "outlier_share": 0.0}
SUITE = msgspec.structs.replace(
    REALISTIC,
    gnss=msgspec.structs.replace(REALISTIC.gnss, lever_arm_m=(0.7, -0.4, -1.1)),
    pressure=msgspec.structs.replace(REALISTIC.pressure, lever_arm_m=(-0.6, 0.3, 0.2)),
    bottom_track=BottomTracking(**ODD, range_m=20.0, beam_noise_sd_mps=0.01, outlier_mps=0.5),
    lbl=Lbl(
        **ODD,
        transponders_m=((0.0, 0.0, 45.0), (60.0, -20.0, 40.0)),
        sound_speed_mps=1500.0,
        sound_speed_sd_mps=3.0,
        range_sd_m=1.0,
        outlier_m=10.0,
        lever_arm_m=(1.0, 0.5, 0.4),
    ),
    usbl=Usbl(
        **ODD,
        latency_ns=0,
        ship_m=(10.0, 20.0),
        position_sd_m=1.0,
        bearing_sd_rad=0.01,
        outlier_m=30.0,
        lever_arm_m=(-0.8, 0.2, -0.3),
    ),
)
RATE = (0.3, -0.2, 0.1)
CONFIG = EstimatorConfig()
LAYOUT = Layout.of(SUITE, CONFIG)
CONTEXT = Context(SUITE, CONFIG.cell_m, RATE)


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
    "gnss": lambda belief, _: gnss.rows(
        belief,
        GnssFix(t_ns=0, north_m=1.0, east_m=2.0, velocity_north_mps=3.0, velocity_east_mps=4.0),
        SUITE.gnss,
        RATE,
    ),
    "tdcp": lambda belief, _: tdcp.rows(
        belief, TdcpFix(t_ns=0, from_t_ns=0, north_m=1.0, east_m=2.0), SUITE.tdcp, SUITE.gnss.lever_arm_m
    ),
    "pressure": lambda belief, _: pressure.rows(belief, PressureDepth(t_ns=0, depth_m=1.0), SUITE.pressure),
    "compass": lambda belief, _: compass.rows(belief, CompassHeading(t_ns=0, heading_rad=0.3), SUITE.compass),
    "adcp": lambda belief, seen: adcp.linearise(belief, seen, SUITE.adcp, CONTEXT).rows,
    "bottom_track": lambda belief, seen: (
        bottom_track.linearise(
            belief,
            BottomTrack(t_ns=0, range_m=np.full(4, 9.0), beam_velocity_mps=seen.beam_velocity_mps[:, 0]),
            SUITE.bottom_track,
            CONTEXT,
        ).rows
    ),
    "lbl": lambda belief, _: lbl.rows(belief, LblRange(t_ns=0, transponder=1, travel_time_s=0.1), SUITE.lbl),
    "usbl": lambda belief, _: usbl.rows(belief, UsblFix(t_ns=0, north_m=1.0, east_m=2.0), SUITE.usbl),
}


@pytest.mark.parametrize("sensor", LINEARISED)
@pytest.mark.parametrize("seed", range(3))
def test_partials_are_minus_the_derivatives_of_the_residual(sensor, seed):
    """1e-6 relative to the largest of a row; a residual is z - h, so its derivative is -H."""
    rng = np.random.default_rng(seed)
    belief, seen = random_belief(rng), ping(rng)
    H = LINEARISED[sensor](belief, seen).dense(LAYOUT.size)
    h = 1e-5
    difference = np.empty_like(H)
    for k in range(LAYOUT.size):
        error = np.zeros(LAYOUT.size)
        error[k] = h
        up, down = belief.copy(), belief.copy()
        up.apply_error(error)
        down.apply_error(-error)
        difference[:, k] = (LINEARISED[sensor](down, seen).residual - LINEARISED[sensor](up, seen).residual) / (2 * h)
    scale = np.abs(difference).max(axis=1, keepdims=True)
    np.testing.assert_allclose(H / scale, difference / scale, atol=1e-6)
