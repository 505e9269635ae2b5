"""Satellite fixes, carrier phase, pressure and compass: statistics against their settings."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from ltv_mpc.localisation.sensor_config import SensorConfig
from sim.sensors.compass import MagneticCompass
from sim.sensors.gnss import GnssReceiver
from sim.sensors.pressure import PressureGauge
from sim.sensors.tdcp import CarrierPhaseReceiver
from tests.sim.worlds import S, check_white, instant

PAPER, REALISTIC = SensorConfig.load("paper"), SensorConfig.load("realistic")
COUNT = 6000
TILT = (0.03, -0.05)


def test_satellite_fixes_are_off_by_the_tables_standard_deviations():
    receiver = GnssReceiver(REALISTIC.gnss, 3)
    at = {"position": (3.0, -4.0, 0.0), "velocity": (0.1, -0.2, 0.0)}
    fixes = [receiver.sample(instant(-k * S, **at))[0] for k in range(COUNT)]
    check_white([(f.north_m - 3.0, f.east_m + 4.0) for f in fixes], 5.0)
    check_white([(f.velocity_north_mps - 0.1, f.velocity_east_mps + 0.2) for f in fixes], 0.02)


def test_carrier_phase_is_the_displacement_since_the_last_epoch():
    phase = CarrierPhaseReceiver(REALISTIC.tdcp, 3)
    said = [phase.sample(instant((k - COUNT) * S, position=(0.3 * k, -0.2 * k, 0.0))) for k in range(COUNT + 1)]
    assert said[0] == []
    fixes = [fix for (fix,) in said[1:]]
    assert [f.t_ns - f.from_t_ns for f in fixes] == [S] * COUNT
    check_white([(f.north_m - 0.3, f.east_m + 0.2) for f in fixes], 0.005)


def test_there_are_no_satellites_during_the_descent():
    receiver, phase = GnssReceiver(PAPER.gnss, 1), CarrierPhaseReceiver(PAPER.tdcp, 1)
    said = [[len(device.sample(instant(t))) for t in (-S, 0, S)] for device in (receiver, phase)]
    assert said == [[1, 1, 0], [0, 1, 0]]


def test_the_fix_of_an_antenna_on_a_mast_has_its_position_and_its_swing():
    """Heading east, 2 m ahead of the origin and 1.5 m above it, rolling at 0.2 rad/s and turning at 0.1 rad/s."""
    mast = msgspec.structs.replace(PAPER.gnss, position_sd_m=1e-12, velocity_sd_mps=1e-12, lever_arm_m=(2.0, 0.0, -1.5))
    east = {"position": (3.0, -4.0, 0.0), "velocity": (0.1, -0.2, 0.0), "attitude": (0.0, 0.0, math.pi / 2)}
    (fix,) = GnssReceiver(mast, 3).sample(instant(rate=(0.2, 0.0, 0.1), **east))
    assert (fix.north_m, fix.east_m) == pytest.approx((3.0, -4.0 + 2.0), abs=1e-9)
    # To starboard (south): 0.1 x 2 of the turn, 0.2 x 1.5 of the roll, which throws a masthead to starboard
    assert (fix.velocity_north_mps, fix.velocity_east_mps) == pytest.approx((0.1 - 0.2 - 0.3, -0.2), abs=1e-9)


def test_carrier_phase_follows_the_antenna_through_a_turn():
    """The origin stays, the heading goes from north to east: an antenna 2 m ahead goes 2 m south and 2 m east."""
    phase = CarrierPhaseReceiver(msgspec.structs.replace(PAPER.tdcp, displacement_sd_m=1e-12), 3, (2.0, 0.0, -1.5))
    phase.sample(instant(-S))
    (fix,) = phase.sample(instant(0, attitude=(0.0, 0.0, math.pi / 2)))
    assert (fix.from_t_ns, fix.t_ns) == (-S, 0)
    assert (fix.north_m, fix.east_m) == pytest.approx((-2.0, 2.0), abs=1e-9)


def test_a_gauge_in_the_tail_is_deeper_when_the_nose_is_up():
    settings = msgspec.structs.replace(PAPER.pressure, depth_sd_m=1e-12, lever_arm_m=(-0.8, 0.0, 0.1))
    (depth,) = PressureGauge(settings, 3).sample(instant(position=(0.0, 0.0, 12.0), attitude=(0.0, 0.2, 1.0)))
    assert depth.depth_m == pytest.approx(12.0 + 0.8 * math.sin(0.2) + 0.1 * math.cos(0.2), abs=1e-9)


def test_depth_from_pressure_is_off_by_a_centimetre():
    gauge = PressureGauge(REALISTIC.pressure, 3)
    now = [instant(k, position=(0.0, 0.0, 12.0), attitude=(*TILT, 0.0)) for k in range(COUNT)]
    check_white([gauge.sample(x)[0].depth_m - 12.0 for x in now], 0.01)


def test_the_papers_compass_has_white_noise_of_a_degree_and_no_bias_and_wraps():
    compass = MagneticCompass(PAPER.compass, 3)
    south = [compass.sample(instant(k * S, attitude=(*TILT, math.pi)))[0].heading_rad for k in range(COUNT)]
    assert np.abs(south).max() <= math.pi
    check_white(np.mod(south, 2 * math.pi) - math.pi, math.radians(1.0))


def test_the_realistic_compass_bias_is_two_degrees_with_an_hour_of_correlation():
    settings = msgspec.structs.replace(REALISTIC.compass, heading_sd_rad=1e-9)
    compasses = [MagneticCompass(settings, seed) for seed in range(800)]
    first, later = ([x.sample(instant(t))[0].heading_rad for x in compasses] for t in (0, 3600 * S))
    check_white(first, math.radians(2.0))
    check_white(later, math.radians(2.0))
    assert np.corrcoef(first, later)[0, 1] == pytest.approx(math.exp(-1.0), abs=4.5 / math.sqrt(800))
