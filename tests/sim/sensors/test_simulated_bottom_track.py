"""The simulated bottom track: geometry computed by hand, errors against its settings by statistics."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
from scipy import stats
from scipy.spatial.transform import Rotation

from ltv_mpc import frames
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.sensors.bottom_track import BottomTracking
from ltv_mpc.validation import rejection_reason
from sim.sensors.adcp import Instrument, Profiler
from sim.sensors.bottom_track import BottomTracker
from sim.sensors.vehicle_state import VehicleState
from sim.water import WaterColumn

ADCP = SensorConfig.load("realistic").adcp
TABLE = BottomTracking(
    period_ns=333_333_333,
    range_m=20.0,
    beam_noise_sd_mps=0.0015,
    missing_share=0.02,
    outlier_share=0.01,
    outlier_mps=0.5,
)
EXACT = msgspec.structs.replace(TABLE, beam_noise_sd_mps=1e-12, missing_share=0.0, outlier_share=0.0)
STRAIGHT = msgspec.structs.replace(ADCP, mounting_sd_rad=0.0, mounting_known_to_rad=0.0, lever_arm_m=(0.0, 0.0, 0.0))
S20, C20 = math.sin(math.radians(20)), math.cos(math.radians(20))
AXES = np.array([[S20, 0, C20], [-S20, 0, C20], [0, S20, C20], [0, -S20, C20]])


def instant(
    roll=0.0, pitch=0.0, heading=0.0, *, depth=5.0, velocity=(0.0, 0.0, 0.0), rate=(0.0, 0.0, 0.0)
) -> VehicleState:
    return VehicleState(0, (1.0, 2.0, depth), velocity, frames.rotation(roll, pitch, heading), np.array(rate), 0.0)


def ping(now, *, adcp=STRAIGHT, settings=EXACT, bottom_m=15.0, seed=0):
    (message,) = BottomTracker(settings, Instrument(adcp, seed), bottom_m, seed).sample(now)
    assert rejection_reason(message) is None
    return message


def test_a_vehicle_at_rest_measures_the_bed_at_rest_at_each_beams_slant_range():
    message = ping(instant(heading=0.7))
    np.testing.assert_allclose(message.beam_velocity_mps, 0.0, atol=1e-10)
    np.testing.assert_allclose(message.range_m, 10.0 / C20, rtol=1e-12)


def test_a_vehicle_that_moves_ahead_and_sinks_approaches_the_bed_in_the_fore_beam():
    message = ping(instant(heading=math.pi / 2, velocity=(0.0, 0.5, 0.2)))
    sinks = 0.2 * C20
    np.testing.assert_allclose(message.beam_velocity_mps, [-0.5 * S20 - sinks, 0.5 * S20 - sinks, -sinks, -sinks])


def test_the_bed_does_not_drift_with_the_water():
    """A vehicle that drifts with the current is at rest for the profiler, and not for the bottom track."""
    water = WaterColumn(np.array([0.0]), np.array([[0.3, 0.1]]))
    now = instant(velocity=(0.3, 0.1, 0.0))
    quiet = msgspec.structs.replace(
        STRAIGHT,
        beam_noise_sd_mps=1e-12,
        missing_share=0.0,
        outlier_share=0.0,
        beam_bias_sd_mps=0.0,
        near_bias_sd_mps=0.0,
    )
    (of_water,) = Profiler(Instrument(quiet, 0), water, 0).sample(now)
    np.testing.assert_allclose(of_water.beam_velocity_mps, 0.0, atol=1e-10)
    np.testing.assert_allclose(
        ping(now, adcp=quiet).beam_velocity_mps, -0.3 * AXES[:, 0] - 0.1 * AXES[:, 1], atol=1e-10
    )


def test_any_attitude_lever_arm_and_turn_by_scipys_rotations():
    """Beams of the profiler's own mounting draw; the transducer at the end of its lever swings with the vehicle."""
    adcp = msgspec.structs.replace(ADCP, mounting_known_to_rad=0.05, mounting_rad=(0.1, -0.2, 0.8))
    roll, pitch, heading, rate = 0.1, -0.07, 2.6, np.array([0.2, -0.1, 0.3])
    v = np.array([0.4, -0.3, 0.1])
    message = ping(instant(roll, pitch, heading, velocity=tuple(v), rate=tuple(rate)), adcp=adcp, seed=6)
    R = Rotation.from_euler("ZYX", [heading, pitch, roll])
    u = R.apply(AXES @ Profiler(Instrument(adcp, 6), WaterColumn(np.zeros(1), np.zeros((1, 2))), 6).mounting.T)
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
    message = ping(instant(roll=math.radians(60.0)), bottom_m=6.0)
    off = np.degrees(np.arccos(np.clip(Rotation.from_euler("ZYX", [0, 0, math.radians(60)]).apply(AXES)[:, 2], -1, 1)))
    assert sorted(off.round()) == [40, 62, 62, 80]
    np.testing.assert_array_equal(np.isnan(message.range_m), off > 70)


def pings(settings, count, seed=3):
    tracker = BottomTracker(settings, Instrument(STRAIGHT, seed), 15.0, seed)
    rows = [tracker.sample(msgspec.structs.replace(instant(), t_ns=k))[0] for k in range(count)]
    return tracker, np.array([row.beam_velocity_mps for row in rows])


def test_noise_is_white_of_the_tables_size_and_without_bias():
    """Sums of squares by chi-square; products of neighbours for memory."""
    _, rows = pings(msgspec.structs.replace(TABLE, missing_share=0.0, outlier_share=0.0), 2000)
    z = rows / 0.0015
    low, high = stats.chi2.ppf([1e-5, 1 - 1e-5], 2000)
    assert ((low < (z**2).sum(axis=0)) & ((z**2).sum(axis=0) < high)).all()
    assert np.abs(z.mean(axis=0)).max() < 4.5 / math.sqrt(2000)
    for product in (z[1:] * z[:-1], z[:, 1:] * z[:, :-1]):
        assert abs(product.mean()) < 4.5 / math.sqrt(product.size)


def test_losses_and_outliers_have_their_shares_and_the_outliers_are_recorded():
    tracker, rows = pings(TABLE, 6000)
    gaps = np.isnan(rows)
    assert gaps.mean() == pytest.approx(0.02, abs=4.5 * math.sqrt(0.02 / rows.size))
    together = stats.binomtest(int(gaps.all(axis=1).sum()), 6000, 0.02**4)
    assert together.pvalue > 1e-4  # each beam by itself, unlike a profiler's whole ping
    # the store keeps the last thousand
    for k in range(5000, 6000):
        wild = tracker.outlier_masks.at(k)
        np.testing.assert_array_equal(wild & ~gaps[k], ~gaps[k] & (np.abs(np.nan_to_num(rows[k])) > 0.25))
    heard = rows[~gaps]
    for sign in (1, -1):
        assert (np.abs(heard - 0.5 * sign) < 0.25).mean() == pytest.approx(
            0.005, abs=4.5 * math.sqrt(0.005 / heard.size)
        )


def test_pings_at_the_bed_and_at_the_water_have_noise_of_their_own():
    white = msgspec.structs.replace(TABLE, missing_share=0.0, outlier_share=0.0)
    instrument, water = Instrument(STRAIGHT, 3), WaterColumn(np.zeros(1), np.zeros((1, 2)))
    quiet = msgspec.structs.replace(STRAIGHT, missing_share=0.0, outlier_share=0.0)
    profiler, tracker = Profiler(Instrument(quiet, 3), water, 3), BottomTracker(white, instrument, 15.0, 3)
    of_water = (profiler.sample(instant())[0].beam_velocity_mps - profiler.bias_mps).ravel() / 0.0194
    of_bed = tracker.sample(instant())[0].beam_velocity_mps / 0.0015
    assert np.abs(of_water[:, None] - of_bed).min() > 1e-6


def test_no_setting_changes_the_noise():
    _, plain = pings(msgspec.structs.replace(TABLE, missing_share=0.0, outlier_share=0.0), 200)
    _, other = pings(msgspec.structs.replace(TABLE, missing_share=0.3, outlier_share=0.3), 200)
    tame = np.abs(plain - other) < 1e-12
    assert 0.4 < tame.mean() < 0.6
