"""Roll and pitch: their size, their period, their smoothness."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sim.attitude import Attitude

RMS, PERIOD = math.radians(1.5), 4.0
MS = 1_000_000


def record(seed: int, seconds: int) -> np.ndarray:
    """Roll and pitch at 10 Hz, (10 x seconds, 2)."""
    attitude = Attitude(RMS, PERIOD, seed)
    return np.array([attitude.at(t * 100 * MS) for t in range(10 * seconds)])


def test_each_axis_has_the_rms_that_its_setting_names_and_axes_and_seeds_are_independent():
    angles = np.column_stack([record(seed, 4000) for seed in (0, 1, 2)])
    np.testing.assert_allclose(np.sqrt((angles**2).mean(axis=0)), RMS, rtol=0.02)
    assert np.abs(np.corrcoef(angles.T) - np.eye(6)).max() < 0.1


def test_the_period_is_that_of_the_setting_and_the_band_is_narrow():
    angles = record(3, 4096)
    power = np.abs(np.fft.rfft(angles[:, 0])) ** 2
    frequency = np.fft.rfftfreq(len(angles), 0.1)
    mean = (power * frequency).sum() / power.sum()
    spread = math.sqrt((power * (frequency - mean) ** 2).sum() / power.sum())
    assert mean == pytest.approx(1 / PERIOD, rel=0.05)
    assert spread < 0.25 / PERIOD


def test_the_motion_is_a_function_of_time_and_seed_alone():
    a, b = Attitude(RMS, PERIOD, 6), Attitude(RMS, PERIOD, 6)
    late = a.at(123_456_789_012)
    b.at(-5)
    assert b.at(123_456_789_012) == late


def test_rates_over_ten_milliseconds_are_the_derivative():
    """Third differences vanish with the cube of the step: nothing jumps."""
    attitude = Attitude(RMS, PERIOD, 7)
    angles = np.array([attitude.at(10 * k * MS) for k in range(2000)])
    omega = 2 * math.pi / PERIOD
    assert np.abs(np.diff(angles, 3, axis=0)).max() < 6 * RMS * (1.3 * omega * 0.01) ** 3


def test_without_tilt_the_vehicle_is_level():
    assert Attitude(0.0, PERIOD, 1).at(77) == (0.0, 0.0)
