"""The simulated profiler: geometry computed by hand, errors against the sensors file by statistics."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ltv_mpc.localisation.sensor_config import SensorConfig
from sim.sensors.adcp import Instrument, Profiler
from sim.water import WaterColumn
from tests.sim.worlds import AXES, C20, S20, check_share, check_white, instant

PAPER, REALISTIC = SensorConfig.load("paper").adcp, SensorConfig.load("realistic").adcp
UNBIASED = {"beam_bias_sd_mps": 0.0, "near_bias_sd_mps": 0.0, "mounting_sd_rad": 0.0, "mounting_known_to_rad": 0.0}
WHITE = msgspec.structs.replace(REALISTIC, missing_share=0.0, outlier_share=0.0, **UNBIASED)
STILL = WaterColumn(np.array([0.0]), np.zeros((1, 2)))
CURRENT = WaterColumn(np.array([0.0]), np.array([[0.3, 0.1]]))
NORTH, EAST = (0.0, 0.0, 0.0), (0.0, 0.0, math.pi / 2)


def exact(**changes):
    return msgspec.structs.replace(WHITE, beam_noise_sd_mps=1e-12, **changes)


def profiler_of(settings, water=STILL, seed=0, bottom_m=None) -> Profiler:
    return Profiler(Instrument(settings, seed), water, seed, bottom_m)


def beams(settings, now, water=STILL, **options):
    return profiler_of(settings, water, **options).sample(now)[0].beam_velocity_mps


@pytest.mark.parametrize(("settings", "first", "last", "cells"), [(PAPER, 0.5, 29.5, 30), (REALISTIC, 0.9, 13.9, 14)])
def test_cells_of_a_metre_fill_the_range_beyond_the_blanking(settings, first, last, cells):
    (message,) = profiler_of(settings).sample(instant())
    assert message.beam_velocity_mps.shape == (4, cells)
    np.testing.assert_allclose(message.range_m, np.linspace(first, last, cells))


def test_each_beam_sees_the_waters_velocity_away_from_the_vehicle():
    """At rest over ground, in a current of 0.3 m/s north and 0.1 m/s east; then in still water, ahead and down."""
    level = exact(lever_arm_m=(0.0, 0.0, 0.0))
    for now, water, expected in (
        (instant(), CURRENT, [0.3 * S20, -0.3 * S20, 0.1 * S20, -0.1 * S20]),
        (instant(attitude=EAST), CURRENT, [0.1 * S20, -0.1 * S20, -0.3 * S20, 0.3 * S20]),
        (instant(velocity=(0.0, 0.0, 0.2)), STILL, [-0.2 * C20] * 4),
        (instant(velocity=(0.5, 0.0, 0.0)), STILL, [-0.5 * S20, 0.5 * S20, 0.0, 0.0]),
        (instant(velocity=(0.3, 0.1, 0.0)), CURRENT, [0.0] * 4),  # drifting with the water
    ):
        np.testing.assert_allclose(beams(level, now, water)[:, 3], expected, atol=1e-9)


def test_the_lever_arm_swings_with_the_turn():
    """0.5 m ahead of the origin, turning to starboard at 0.1 rad/s: 5 cm/s to starboard."""
    arm = (0.5, 0.0, 0.3)
    to_starboard = beams(exact(lever_arm_m=arm), instant(rate=(0.0, 0.0, 0.1)))[:, 0]
    np.testing.assert_allclose(to_starboard, [0.0, 0.0, -0.05 * S20, 0.05 * S20], atol=1e-9)
    swing = np.cross([0.2, -0.1, 0.3], [0.5, 0.4, 0.3])
    turning = beams(exact(lever_arm_m=(0.5, 0.4, 0.3)), instant(rate=(0.2, -0.1, 0.3)))
    np.testing.assert_allclose(turning[:, 0], -AXES @ swing, atol=1e-9)


def test_each_beam_samples_the_depth_that_its_own_direction_reaches():
    """A current that grows by 1 cm/s a metre shows each cell's depth; the vehicle is tilted, the lever arm counts."""
    water = WaterColumn(np.array([0.0, 100.0]), np.array([[0.0, 0.0], [1.0, -0.5]]))
    roll, pitch, heading = 0.1, -0.07, 0.6
    profiler = profiler_of(exact(lever_arm_m=(0.5, 0.1, 0.3)), water)
    (message,) = profiler.sample(instant(attitude=(roll, pitch, heading)))
    R = Rotation.from_euler("ZYX", [heading, pitch, roll])
    direction = R.apply(AXES)[:, :, None]
    depth = 5.0 + R.apply([0.5, 0.1, 0.3])[2] + message.range_m * direction[:, 2]
    expected = 0.01 * depth * direction[:, 0] - 0.005 * depth * direction[:, 1]
    np.testing.assert_allclose(message.beam_velocity_mps, expected, atol=1e-9)


def errors(settings, seed: int, pings: int) -> np.ndarray:
    """Measured minus error-free, (pings, 4, K)."""
    profiler = profiler_of(settings, seed=seed)
    return np.array([profiler.sample(instant())[0].beam_velocity_mps for _ in range(pings)])


def test_noise_is_white_and_beams_and_cells_are_lost_or_wild_by_the_tables_shares():
    white = errors(WHITE, 11, 3000)
    check_white(white, 0.0194)
    assert ((white[:, 0] - white[:, 1]) / (2 * S20)).std() == pytest.approx(0.0401, rel=0.02)  # horizontally
    rows = errors(msgspec.structs.replace(REALISTIC, **UNBIASED), 11, 3000)
    gaps = np.isnan(rows)
    assert (gaps.all(axis=2) == gaps.any(axis=2)).all()  # the whole beam
    check_share(gaps[:, :, 0], 0.02)
    for sign in (1, -1):
        wild = np.abs(rows - sign * 0.5) < 0.25
        check_share(wild[~gaps], 0.005)
        np.testing.assert_allclose(rows[wild], white[wild] + sign * 0.5, atol=1e-12)  # no setting changes the noise


def test_the_papers_profiler_has_no_bias_gap_or_outlier():
    check_white(errors(PAPER, 3, 800), 0.01)
    np.testing.assert_array_equal(profiler_of(PAPER, seed=3).mounting, np.eye(3))


def test_over_many_instruments_the_realistic_biases_have_the_tables_size():
    seeds = 400
    profilers = [profiler_of(REALISTIC, seed=seed) for seed in range(seeds)]
    bias = np.array([profiler.bias_mps for profiler in profilers])
    expected = np.sqrt(0.005**2 + (0.015 * np.exp(-profilers[0].ranges_m / 3.0)) ** 2)
    np.testing.assert_allclose(bias.std(axis=(0, 1)), expected, rtol=4 / math.sqrt(8 * seeds))
    np.testing.assert_allclose(bias.mean(axis=(0, 1)), 0.0, atol=4 * expected.max() / math.sqrt(4 * seeds))
    assert np.abs(np.corrcoef(bias[:, :, -1].T) - np.eye(4)).max() < 4.5 / math.sqrt(seeds)
    left = Rotation.from_matrix([Instrument(REALISTIC, s).misalignment for s in range(seeds)]).as_rotvec()
    check_white(left, math.radians(0.3))  # the error of the calibration remains


def test_an_instruments_bias_stays_through_the_run():
    settings = msgspec.structs.replace(
        REALISTIC, missing_share=0.0, outlier_share=0.0, mounting_sd_rad=0.0, mounting_known_to_rad=0.0
    )
    check_white(errors(settings, 7, 1500) - profiler_of(settings, seed=7).bias_mps, 0.0194)


def test_nominal_mounting_is_applied_before_the_misalignment():
    settings = exact(mounting_rad=(0.2, -0.4, 1.1), mounting_known_to_rad=0.05, lever_arm_m=(0.0, 0.0, 0.0))
    misalignment = Instrument(settings, 4).misalignment
    assert np.abs(misalignment - np.eye(3)).max() > 0.01
    v = (0.4, -0.3, 0.2)
    nominal = Rotation.from_euler("ZYX", [1.1, -0.4, 0.2])
    in_body = nominal.apply(AXES) @ misalignment.T
    np.testing.assert_allclose(beams(settings, instant(velocity=v), seed=4)[:, 0], -in_body @ v, atol=1e-9)
    np.testing.assert_allclose(profiler_of(settings, seed=4).mounting, misalignment @ nominal.as_matrix())


@pytest.mark.parametrize(
    ("bottom_m", "depth", "pitch", "altitude"),
    [
        (15.0, 5.0, 0.0, 9.7),  # transducer at 5.3 m
        (15.16, 5.0, 0.3, 10.021),  # only 0.3 cos 0.3 - 0.5 sin 0.3 = 0.139 m below the origin
        (15.0, 14.7, 0.0, 0.0),
        (15.0, 40.0, 0.0, -1.0),
        (None, 5.0, 0.0, 100.0),
    ],
)
def test_cells_beyond_the_altitude_are_lost_in_the_side_lobes_echo_off_the_bed(bottom_m, depth, pitch, altitude):
    now = instant(position=(0.0, 0.0, depth), attitude=(0.0, pitch, 0.0))
    heard = ~np.isnan(beams(exact(lever_arm_m=(0.5, 0.0, 0.3)), now, bottom_m=bottom_m))
    np.testing.assert_array_equal(heard, np.tile(np.arange(14) + 0.9 <= altitude, (4, 1)))
