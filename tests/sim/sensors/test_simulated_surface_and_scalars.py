"""Satellite fixes, carrier phase, pressure and compass: statistics against their settings."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from ltv_mpc import frames
from ltv_mpc.localisation.sensor_config import SensorConfig
from sim.sensors.compass import MagneticCompass
from sim.sensors.gnss import GnssReceiver
from sim.sensors.pressure import PressureGauge
from sim.sensors.tdcp import CarrierPhaseReceiver
from sim.sensors.vehicle_state import VehicleState

SUITES = [SensorConfig.load(name) for name in ("paper", "realistic")]
S = 1_000_000_000
NORTH, EAST = frames.rotation(0.0, 0.0, 0.0), frames.rotation(0.0, 0.0, math.pi / 2)
COUNT = 6000
SIGMA = 4.5 / math.sqrt(COUNT)
"""4.5 of the estimate's own standard deviations, in units of the noise's."""


def instant(t_ns: int, north=3.0, east=-4.0, depth=0.0, heading=0.0) -> VehicleState:
    R = frames.rotation(0.03, -0.05, heading)
    return VehicleState(t_ns, (north, east, depth), (0.1, -0.2, 0.0), R, np.zeros(3), 0.0)


def check_white(errors: np.ndarray, sd: float) -> None:
    """Check that errors have mean zero, the given standard deviation and no correlation in time."""
    assert abs(errors.mean()) < SIGMA * sd
    assert errors.std() == pytest.approx(sd, rel=SIGMA / math.sqrt(2))
    assert abs(np.corrcoef(errors[1:], errors[:-1])[0, 1]) < SIGMA


@pytest.mark.parametrize("suite", SUITES, ids=lambda s: s.name)
def test_satellite_fixes_are_off_by_the_tables_standard_deviations(suite):
    receiver = GnssReceiver(suite.gnss, 3)
    fixes = [receiver.sample(instant(-k * S))[0] for k in range(COUNT)]
    check_white(np.array([f.north_m for f in fixes]) - 3.0, 5.0)
    check_white(np.array([f.east_m for f in fixes]) + 4.0, 5.0)
    check_white(np.array([f.velocity_north_mps for f in fixes]) - 0.1, 0.02)
    check_white(np.array([f.velocity_east_mps for f in fixes]) + 0.2, 0.02)


@pytest.mark.parametrize("suite", SUITES, ids=lambda s: s.name)
def test_carrier_phase_is_the_displacement_since_the_last_epoch(suite):
    phase = CarrierPhaseReceiver(suite.tdcp, 3)
    assert phase.sample(instant(-COUNT * S, north=0.0, east=0.0)) == []
    fixes = [phase.sample(instant((k - COUNT) * S, north=0.3 * k, east=-0.2 * k))[0] for k in range(1, COUNT + 1)]
    assert [f.t_ns - f.from_t_ns for f in fixes] == [S] * COUNT
    check_white(np.array([f.north_m for f in fixes]) - 0.3, 0.005)
    check_white(np.array([f.east_m for f in fixes]) + 0.2, 0.005)


def test_there_are_no_satellites_during_the_descent():
    receiver, phase = GnssReceiver(SUITES[0].gnss, 1), CarrierPhaseReceiver(SUITES[0].tdcp, 1)
    phase.sample(instant(-S))
    assert len(receiver.sample(instant(0))) == 1
    assert len(phase.sample(instant(0))) == 1
    assert receiver.sample(instant(1)) == []
    assert phase.sample(instant(S)) == []


def test_the_fix_of_an_antenna_on_a_mast_has_its_position_and_its_swing():
    """Heading east, 2 m ahead of the origin and 1.5 m above it, rolling at 0.2 rad/s and turning at 0.1 rad/s."""
    quiet = msgspec.structs.replace(SUITES[0].gnss, position_sd_m=1e-12, velocity_sd_mps=1e-12)
    now = VehicleState(0, (3.0, -4.0, 0.0), (0.1, -0.2, 0.0), EAST, np.array([0.2, 0.0, 0.1]), 0.0)
    (fix,) = GnssReceiver(msgspec.structs.replace(quiet, lever_arm_m=(2.0, 0.0, -1.5)), 3).sample(now)
    assert (fix.north_m, fix.east_m) == pytest.approx((3.0, -4.0 + 2.0), abs=1e-9)
    # To starboard (south): 0.1 x 2 of the turn, 0.2 x 1.5 of the roll, which throws a masthead to starboard
    assert (fix.velocity_north_mps, fix.velocity_east_mps) == pytest.approx((0.1 - 0.2 - 0.3, -0.2), abs=1e-9)


def test_carrier_phase_follows_the_antenna_through_a_turn():
    """The origin stays, the heading goes from north to east: an antenna 2 m ahead goes 2 m south and 2 m east."""
    phase = CarrierPhaseReceiver(msgspec.structs.replace(SUITES[0].tdcp, displacement_sd_m=1e-12), 3, (2.0, 0.0, -1.5))
    north, east = (
        VehicleState(t, (3.0, -4.0, 0.0), (0.0, 0.0, 0.0), R, np.zeros(3), 0.0) for t, R in ((-S, NORTH), (0, EAST))
    )
    phase.sample(north)
    (fix,) = phase.sample(east)
    assert (fix.from_t_ns, fix.t_ns) == (-S, 0)
    assert (fix.north_m, fix.east_m) == pytest.approx((-2.0, 2.0), abs=1e-9)


def test_a_gauge_in_the_tail_is_deeper_when_the_nose_is_up():
    settings = msgspec.structs.replace(SUITES[0].pressure, depth_sd_m=1e-12, lever_arm_m=(-0.8, 0.0, 0.1))
    up = VehicleState(0, (0.0, 0.0, 12.0), (0.0, 0.0, 0.0), frames.rotation(0.0, 0.2, 1.0), np.zeros(3), 0.0)
    (depth,) = PressureGauge(settings, 3).sample(up)
    assert depth.depth_m == pytest.approx(12.0 + 0.8 * math.sin(0.2) + 0.1 * math.cos(0.2), abs=1e-9)


@pytest.mark.parametrize("suite", SUITES, ids=lambda s: s.name)
def test_depth_from_pressure_is_off_by_a_centimetre(suite):
    gauge = PressureGauge(suite.pressure, 3)
    check_white(np.array([gauge.sample(instant(k, depth=12.0))[0].depth_m for k in range(COUNT)]) - 12.0, 0.01)


def test_the_papers_compass_has_white_noise_of_a_degree_and_no_bias():
    compass = MagneticCompass(SUITES[0].compass, 3)
    headings = [compass.sample(instant(k * S, heading=1.0))[0].heading_rad for k in range(COUNT)]
    check_white(np.array(headings) - 1.0, math.radians(1.0))


def test_the_realistic_compass_bias_is_two_degrees_with_an_hour_of_correlation():
    settings = msgspec.structs.replace(SUITES[1].compass, heading_sd_rad=1e-9)
    first, later = [], []
    for seed in range(800):
        compass = MagneticCompass(settings, seed)
        first.append(compass.sample(instant(0))[0].heading_rad)
        later.append(compass.sample(instant(3600 * S))[0].heading_rad)
    for biases in (first, later):
        assert np.std(biases) == pytest.approx(math.radians(2.0), rel=4.5 / math.sqrt(1600))
    assert np.corrcoef(first, later)[0, 1] == pytest.approx(math.exp(-1.0), abs=4.5 / math.sqrt(800))


def test_headings_are_wrapped():
    compass = MagneticCompass(SUITES[0].compass, 3)
    headings = np.array([compass.sample(instant(k, heading=math.pi))[0].heading_rad for k in range(400)])
    assert (np.abs(headings) <= math.pi).all()
    assert 0.3 < (headings < 0).mean() < 0.7
