"""The simulated profiler: geometry computed by hand, errors against the sensors file by statistics."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ltv_mpc import frames
from ltv_mpc.localisation.sensor_config import SensorConfig
from sim.scenario import Water
from sim.sensors.adcp import Instrument, Profiler
from sim.sensors.vehicle_state import VehicleState
from sim.water import WaterColumn, make

PAPER, REALISTIC = SensorConfig.load("paper").adcp, SensorConfig.load("realistic").adcp
SILENT = {"beam_noise_sd_mps": 1e-12, "missing_share": 0.0, "outlier_share": 0.0, "outlier_mps": 0.0}
UNBIASED = {"beam_bias_sd_mps": 0.0, "near_bias_sd_mps": 0.0, "mounting_sd_rad": 0.0, "mounting_known_to_rad": 0.0}
S20, C20 = math.sin(math.radians(20)), math.cos(math.radians(20))
STILL = WaterColumn(np.array([0.0]), np.zeros((1, 2)))


def exact(adcp=REALISTIC, **changes):
    return msgspec.structs.replace(adcp, **{**SILENT, **UNBIASED, **changes})


def instant(
    roll=0.0, pitch=0.0, heading=0.0, *, depth=5.0, velocity=(0.0, 0.0, 0.0), rate=(0.0, 0.0, 0.0)
) -> VehicleState:
    return VehicleState(0, (1.0, 2.0, depth), velocity, frames.rotation(roll, pitch, heading), np.array(rate), 0.0)


def profiler_of(settings, water=STILL, seed=0, bottom_m=None) -> Profiler:
    return Profiler(Instrument(settings, seed), water, seed, bottom_m)


def ping(settings, water, now, seed=0, bottom_m=None):
    (message,) = profiler_of(settings, water, seed, bottom_m).sample(now)
    return message


@pytest.mark.parametrize(
    ("settings", "first", "last", "cells"),
    [(PAPER, 0.5, 29.5, 30), (REALISTIC, 0.9, 13.9, 14)],
    ids=["paper", "realistic"],
)
def test_cells_of_a_metre_fill_the_range_beyond_the_blanking(settings, first, last, cells):
    message = ping(settings, STILL, instant())
    assert message.range_m.shape == (cells,)
    assert message.beam_velocity_mps.shape == (4, cells)
    assert (message.range_m[0], message.range_m[-1]) == pytest.approx((first, last))
    np.testing.assert_allclose(np.diff(message.range_m), 1.0)


def test_each_beam_sees_the_waters_velocity_away_from_the_vehicle():
    """The vehicle heads north, at rest over ground, in a current of 0.3 m/s north and 0.1 m/s east."""
    water = WaterColumn(np.array([0.0]), np.array([[0.3, 0.1]]))
    beams = ping(exact(lever_arm_m=(0.0, 0.0, 0.0)), water, instant()).beam_velocity_mps
    np.testing.assert_allclose(beams[:, 0], [0.3 * S20, -0.3 * S20, 0.1 * S20, -0.1 * S20], atol=1e-9)
    beams = ping(exact(lever_arm_m=(0.0, 0.0, 0.0)), water, instant(heading=math.pi / 2)).beam_velocity_mps
    np.testing.assert_allclose(beams[:, 0], [0.1 * S20, -0.1 * S20, -0.3 * S20, 0.3 * S20], atol=1e-9)


def test_a_vehicle_that_sinks_approaches_the_water_below():
    beams = ping(exact(), STILL, instant(velocity=(0.0, 0.0, 0.2))).beam_velocity_mps
    np.testing.assert_allclose(beams, -0.2 * C20, atol=1e-9)


def test_a_vehicle_that_moves_ahead_approaches_the_water_in_the_fore_beam():
    beams = ping(exact(), STILL, instant(velocity=(0.5, 0.0, 0.0))).beam_velocity_mps
    np.testing.assert_allclose(beams[:, 3], [-0.5 * S20, 0.5 * S20, 0.0, 0.0], atol=1e-9)


def test_the_lever_arm_swings_with_the_turn():
    """0.5 m ahead of the origin, turning to starboard at 0.1 rad/s: 5 cm/s to starboard."""
    beams = ping(exact(lever_arm_m=(0.5, 0.0, 0.3)), STILL, instant(rate=(0.0, 0.0, 0.1))).beam_velocity_mps
    np.testing.assert_allclose(beams[:, 0], [0.0, 0.0, -0.05 * S20, 0.05 * S20], atol=1e-9)
    # Pitching up at 0.1 rad/s: the transducer ahead rises at 5 cm/s, and 0.3 m below the origin it goes ahead at 3.
    beams = ping(exact(lever_arm_m=(0.5, 0.0, 0.3)), STILL, instant(rate=(0.0, 0.1, 0.0))).beam_velocity_mps
    rises, ahead = 0.05 * C20, 0.03 * S20
    np.testing.assert_allclose(beams[:, 0], [rises - ahead, rises + ahead, rises, rises], atol=1e-9)
    # Any arm and any turn, by numpy's cross product
    swing = np.cross([0.2, -0.1, 0.3], [0.5, 0.4, 0.3])
    beams = ping(exact(lever_arm_m=(0.5, 0.4, 0.3)), STILL, instant(rate=(0.2, -0.1, 0.3))).beam_velocity_mps
    axes = np.array([[S20, 0, C20], [-S20, 0, C20], [0, S20, C20], [0, -S20, C20]])
    np.testing.assert_allclose(beams[:, 0], -axes @ swing, atol=1e-9)


def test_each_beam_samples_the_depth_that_its_own_direction_reaches():
    """A current that grows by 1 cm/s a metre shows each cell's depth; the vehicle is tilted, the lever arm counts."""
    water = WaterColumn(np.array([0.0, 100.0]), np.array([[0.0, 0.0], [1.0, -0.5]]))
    roll, pitch, heading = 0.1, -0.07, 0.6
    settings = exact(lever_arm_m=(0.5, 0.1, 0.3))
    message = ping(settings, water, instant(roll, pitch, heading))
    R = Rotation.from_euler("ZYX", [heading, pitch, roll])
    transducer = 5.0 + R.apply([0.5, 0.1, 0.3])[2]
    for i, axis in enumerate([[S20, 0, C20], [-S20, 0, C20], [0, S20, C20], [0, -S20, C20]]):
        direction = R.apply(axis)
        depth = transducer + message.range_m * direction[2]
        expected = 0.01 * depth * direction[0] - 0.005 * depth * direction[1]
        np.testing.assert_allclose(message.beam_velocity_mps[i], expected, atol=1e-9)


def errors(settings, seed: int, pings: int) -> np.ndarray:
    """Measured minus error-free, (pings, 4, K)."""
    profiler = profiler_of(settings, seed=seed)
    return np.array([profiler.sample(instant())[0].beam_velocity_mps for _ in range(pings)])


@pytest.mark.parametrize(("settings", "beam", "horizontal"), [(PAPER, 0.01, 0.0207), (REALISTIC, 0.0194, 0.0401)])
def test_white_noise_has_the_tables_size_along_a_beam_and_horizontally(settings, beam, horizontal):
    rows = errors(msgspec.structs.replace(settings, missing_share=0.0, outlier_share=0.0, **UNBIASED), 3, 1500)
    count = rows.size
    assert rows.std() == pytest.approx(beam, rel=4 / math.sqrt(2 * count))
    assert abs(rows.mean()) < 4 * beam / math.sqrt(count)
    ahead = (rows[:, 0] - rows[:, 1]) / (2 * S20)
    assert ahead.std() == pytest.approx(horizontal, rel=0.02)
    # White from ping to ping and from cell to cell: chi-square of neighbours' products
    for product in (rows[1:] * rows[:-1], rows[:, :, 1:] * rows[:, :, :-1], rows[:, 1:] * rows[:, :-1]):
        assert abs(product.mean()) < 4 * beam**2 / math.sqrt(product.size)


def test_the_papers_profiler_has_no_bias_gap_or_outlier():
    rows = errors(PAPER, 3, 800)
    assert not np.isnan(rows).any()
    assert np.abs(rows).max() < 5.5 * 0.01
    assert np.abs(rows.mean(axis=0)).max() < 4.5 * 0.01 / math.sqrt(800)
    np.testing.assert_allclose(profiler_of(PAPER, seed=3).mounting, np.eye(3), atol=0)


def test_over_many_instruments_the_realistic_biases_have_the_tables_size():
    seeds = 400
    bias = np.array([profiler_of(REALISTIC, seed=seed).bias_mps for seed in range(seeds)])
    r = profiler_of(REALISTIC).ranges_m
    expected = np.sqrt(0.005**2 + (0.015 * np.exp(-r / 3.0)) ** 2)
    np.testing.assert_allclose(bias.std(axis=(0, 1)), expected, rtol=4 / math.sqrt(8 * seeds))
    np.testing.assert_allclose(bias.mean(axis=(0, 1)), 0.0, atol=4 * expected.max() / math.sqrt(4 * seeds))
    across = np.corrcoef(bias[:, :, -1].T) - np.eye(4)
    assert np.abs(across).max() < 4.5 / math.sqrt(seeds)


def test_an_instruments_bias_stays_through_the_run():
    settings = msgspec.structs.replace(REALISTIC, missing_share=0.0, outlier_share=0.0)
    profiler = profiler_of(settings, seed=7)
    level = msgspec.structs.replace(settings, mounting_sd_rad=0.0, mounting_known_to_rad=0.0)
    rows = errors(level, 7, 1500)
    np.testing.assert_allclose(rows.mean(axis=0), profiler.bias_mps, atol=4.5 * 0.0194 / math.sqrt(1500))


def test_two_percent_of_the_beams_are_silent_and_one_percent_of_the_cells_outliers():
    settings = msgspec.structs.replace(REALISTIC, **UNBIASED)
    rows = errors(settings, 11, 3000)
    gaps = np.isnan(rows)
    assert (gaps.all(axis=2) == gaps.any(axis=2)).all()  # the whole beam
    beams = gaps[:, :, 0].mean()
    assert beams == pytest.approx(0.02, abs=4 * math.sqrt(0.02 / 12_000))
    heard = rows[~gaps]
    for sign in (1, -1):
        wild = np.abs(heard - sign * 0.5) < 0.25
        assert wild.mean() == pytest.approx(0.005, abs=4 * math.sqrt(0.005 / heard.size))
        assert heard[wild].mean() == pytest.approx(sign * 0.5, abs=0.005)


def test_the_remaining_misalignment_is_the_error_of_the_calibration():
    left = np.array([Rotation.from_matrix(Instrument(REALISTIC, s).misalignment).as_rotvec() for s in range(500)])
    known_to = math.radians(0.3)
    np.testing.assert_allclose(left.std(axis=0), known_to, rtol=4.5 / math.sqrt(1000))
    np.testing.assert_allclose(left.mean(axis=0), 0.0, atol=4.5 * known_to / math.sqrt(500))


def test_a_misalignment_about_the_vertical_turns_the_measured_water_the_other_way():
    settings = exact(mounting_known_to_rad=0.2, lever_arm_m=(0.0, 0.0, 0.0))
    profiler = profiler_of(settings, WaterColumn(np.array([0.0]), np.array([[0.3, 0.0]])), 5)
    beams = profiler.sample(instant())[0].beam_velocity_mps
    axes = np.array([[S20, 0, C20], [-S20, 0, C20], [0, S20, C20], [0, -S20, C20]])
    seen = np.linalg.lstsq(axes, beams[:, 0], rcond=None)[0]
    np.testing.assert_allclose(seen, profiler.mounting.T @ [0.3, 0.0, 0.0], atol=1e-9)


def test_a_profiler_turned_by_an_eighth_looks_between_the_bows_and_the_beam():
    """At 0.5 m/s ahead and to starboard, beam 1, at 45 deg, measures all of it; beams 3 and 4 nothing."""
    ahead = 0.5 * math.sqrt(0.5)
    settings = exact(mounting_rad=(0.0, 0.0, math.pi / 4))
    beams = ping(settings, STILL, instant(velocity=(ahead, ahead, 0.0))).beam_velocity_mps
    np.testing.assert_allclose(beams[:, 2], [-0.5 * S20, 0.5 * S20, 0.0, 0.0], atol=1e-9)


def test_nominal_mounting_is_applied_before_the_misalignment():
    settings = exact(mounting_rad=(0.2, -0.4, 1.1), mounting_known_to_rad=0.05, lever_arm_m=(0.0, 0.0, 0.0))
    instrument = Instrument(settings, 4)
    assert np.abs(instrument.misalignment - np.eye(3)).max() > 0.01
    v = np.array([0.4, -0.3, 0.2])
    message = ping(settings, STILL, instant(velocity=tuple(v)), seed=4)
    axes = np.array([[S20, 0, C20], [-S20, 0, C20], [0, S20, C20], [0, -S20, C20]])
    nominal = Rotation.from_euler("ZYX", [1.1, -0.4, 0.2])
    in_body = nominal.apply(axes) @ instrument.misalignment.T
    np.testing.assert_allclose(message.beam_velocity_mps[:, 0], -in_body @ v, atol=1e-9)
    np.testing.assert_allclose(profiler_of(settings, seed=4).mounting, instrument.misalignment @ nominal.as_matrix())


def test_cells_beyond_the_altitude_are_lost_in_the_side_lobes_echo_off_the_bed():
    """Transducer at 5.3 m, bed at 15: cells of the realistic profiler are centred at 0.9, 1.9, ... and 9.7 m is far."""
    settings = exact(lever_arm_m=(0.5, 0.0, 0.3))
    heard = ~np.isnan(ping(settings, STILL, instant(), bottom_m=15.0).beam_velocity_mps)
    np.testing.assert_array_equal(heard, np.tile(np.arange(14) + 0.9 <= 9.7, (4, 1)))
    assert heard.sum() == 4 * 9
    # Pitched up by 0.3 rad it is only 0.3 cos 0.3 - 0.5 sin 0.3 = 0.139 m below the origin, 10.021 m above the bed
    heard = ~np.isnan(ping(settings, STILL, instant(pitch=0.3), bottom_m=15.16).beam_velocity_mps)
    np.testing.assert_array_equal(heard, np.tile(np.arange(14) + 0.9 <= 10.021, (4, 1)))
    assert heard.sum() == 4 * 10
    assert not np.isnan(ping(settings, STILL, instant(), bottom_m=None).beam_velocity_mps).any()


@pytest.mark.parametrize("depth", [14.7, 15.0, 40.0])
def test_a_profiler_at_or_below_the_bed_has_no_return(depth):
    message = ping(exact(lever_arm_m=(0.0, 0.0, 0.3)), STILL, instant(depth=depth), bottom_m=15.0)
    assert np.isnan(message.beam_velocity_mps).all()


def test_outlier_masks_are_stored_by_the_pings_validity_time():
    settings = msgspec.structs.replace(exact(), beam_noise_sd_mps=1e-6, outlier_share=0.2, outlier_mps=0.5)
    profiler = profiler_of(settings, seed=8)
    pings = [profiler.sample(msgspec.structs.replace(instant(), t_ns=k))[0] for k in range(30)]
    for message in pings:
        mask = profiler.outlier_masks.at(message.t_ns)
        np.testing.assert_array_equal(mask, np.abs(message.beam_velocity_mps) > 0.25)
    assert profiler.outlier_masks.at(30) is None
    np.testing.assert_array_equal(profiler.outliers, profiler.outlier_masks.at(29))


def test_no_setting_changes_the_noise_of_the_pings():
    wild = msgspec.structs.replace(PAPER, missing_share=0.3, outlier_share=0.4, outlier_mps=0.5, beam_bias_sd_mps=0.0)
    plain, other = errors(PAPER, 2, 50), errors(wild, 2, 50)
    tame = np.abs(plain - other) < 1e-12
    assert 0.3 < tame.mean() < 0.6
    assert np.isnan(other).any(axis=2).mean() == pytest.approx(0.3, abs=0.15)


def test_a_cells_mean_differs_from_its_centre_by_at_most_the_stated_share():
    spread = []
    for seed in range(60):
        water = make(Water(), seed)
        for depth in np.arange(1.0, 60.0, 0.37):
            cell = water.over(depth + np.linspace(-0.5, 0.5, 101), 0).mean(axis=0)
            spread.append(cell - water.at(depth, 0))
    assert np.std(spread) < 0.09 * 0.04
