"""The simulated bottom track: geometry computed by hand, errors against its settings by statistics."""

from __future__ import annotations

import math

import numpy as np
import pytest
from msgspec.structs import replace
from scipy import stats
from scipy.spatial.transform import Rotation

from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.validation import rejection_reason
from sim.sensors.adcp import Instrument, Profiler
from sim.sensors.bottom_track import BottomTracker
from sim.water import WaterColumn
from tests.ltv_mpc.localisation.sensors.every_sensor import EVERY_SENSOR
from tests.sim.worlds import AXES, C20, S20, check_share, check_white, instant

ADCP = SensorConfig.load("realistic").adcp
TABLE = replace(EVERY_SENSOR.bottom_track, beam_noise_sd_mps=0.0015, missing_share=0.02, outlier_share=0.01)
WHITE = replace(TABLE, missing_share=0.0, outlier_share=0.0)
EXACT = replace(WHITE, beam_noise_sd_mps=1e-12)
STRAIGHT = replace(ADCP, mounting_sd_rad=0.0, mounting_known_to_rad=0.0, lever_arm_m=(0.0, 0.0, 0.0))
STILL = WaterColumn(np.zeros(1), np.zeros((1, 2)))


def ping(now, *, adcp=STRAIGHT, bottom_m=15.0, seed=0):
    (message,) = BottomTracker(EXACT, Instrument(adcp, seed), bottom_m, seed).sample(now)
    assert rejection_reason(message) is None
    return message


def test_a_vehicle_that_moves_ahead_and_sinks_approaches_the_bed_in_the_fore_beam():
    message = ping(instant(attitude=(0.0, 0.0, math.pi / 2), velocity=(0.0, 0.5, 0.2)))
    sinks = 0.2 * C20
    np.testing.assert_allclose(message.beam_velocity_mps, [-0.5 * S20 - sinks, 0.5 * S20 - sinks, -sinks, -sinks])
    np.testing.assert_allclose(message.range_m, 10.0 / C20, rtol=1e-12)


def test_any_attitude_lever_arm_and_turn_by_scipys_rotations():
    """Beams of the profiler's own mounting draw; the transducer at the end of its lever swings with the vehicle."""
    adcp = replace(ADCP, mounting_known_to_rad=0.05, mounting_rad=(0.1, -0.2, 0.8))
    roll, pitch, heading, rate = 0.1, -0.07, 2.6, (0.2, -0.1, 0.3)
    v = (0.4, -0.3, 0.1)
    message = ping(instant(attitude=(roll, pitch, heading), velocity=v, rate=rate), adcp=adcp, seed=6)
    R = Rotation.from_euler("ZYX", [heading, pitch, roll])
    u = R.apply(AXES @ Profiler(Instrument(adcp, 6), STILL, 6).mounting.T)
    transducer = v + R.apply(np.cross(rate, [0.5, 0.0, 0.3]))
    np.testing.assert_allclose(message.beam_velocity_mps, -u @ transducer, atol=1e-9)
    np.testing.assert_allclose(message.range_m, (15.0 - 5.0 - R.apply([0.5, 0.0, 0.3])[2]) / u[:, 2], rtol=1e-9)


@pytest.mark.parametrize(
    ("bottom_m", "found"), [(24.999, True), (25.001, False), (5.001, True), (5.0, False), (4.0, False), (None, False)]
)
def test_the_bed_is_found_within_range_below_and_never_above(bottom_m, found):
    message = ping(instant(), bottom_m=bottom_m)
    assert np.isnan(message.range_m).all() == np.isnan(message.beam_velocity_mps).all() == (not found)


def test_a_beam_that_looks_along_the_bed_does_not_find_it():
    """Rolled by 60 deg to starboard the beam to port looks 80 deg off the vertical, the one to starboard 40."""
    message = ping(instant(attitude=(math.radians(60.0), 0.0, 0.0)), bottom_m=6.0)
    assert np.isnan(message.range_m).tolist() == [False, False, False, True]


def pings(settings, count, seed=3):
    tracker = BottomTracker(settings, Instrument(STRAIGHT, seed), 15.0, seed)
    return np.array([tracker.sample(instant(k))[0].beam_velocity_mps for k in range(count)])


def test_noise_is_white_of_the_tables_size_and_each_beam_is_lost_by_itself():
    white, rows = pings(WHITE, 6000), pings(TABLE, 6000)
    check_white(white, 0.0015)
    gaps = np.isnan(rows)
    check_share(gaps, 0.02)
    assert stats.binomtest(int(gaps.all(axis=1).sum()), 6000, 0.02**4).pvalue > 1e-4
    for sign in (1, -1):
        wild = np.abs(rows - 0.5 * sign) < 0.25
        check_share(wild[~gaps], 0.005)
        np.testing.assert_allclose(rows[wild], white[wild] + 0.5 * sign, atol=1e-12)  # no setting changes the noise


def test_pings_at_the_bed_and_at_the_water_have_noise_of_their_own():
    quiet = replace(STRAIGHT, missing_share=0.0, outlier_share=0.0)
    profiler = Profiler(Instrument(quiet, 3), STILL, 3)
    of_water = (profiler.sample(instant())[0].beam_velocity_mps - profiler.bias_mps).ravel() / 0.0194
    assert np.abs(of_water[:, None] - pings(WHITE, 1)[0] / 0.0015).min() > 1e-6
