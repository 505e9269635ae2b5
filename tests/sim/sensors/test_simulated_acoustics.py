"""Simulated LBL and USBL: travel times against a root finder on the true path, statistics against their tables."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from msgspec.structs import replace
from scipy import stats
from scipy.optimize import brentq

from ltv_mpc import frames
from sim.sensors.lbl import AcousticTransceiver
from sim.sensors.usbl import ShipTransceiver
from sim.sensors.vehicle_state import motion_between
from tests.ltv_mpc.localisation.sensors.every_sensor import EVERY_SENSOR
from tests.sim.worlds import MS, S, check_share, check_white, instant, truth

LBL = replace(
    EVERY_SENSOR.lbl,
    transponders_m=((400.0, 0.0, 60.0), (-75.0, 130.0, 80.0)),
    sound_speed_sd_mps=2.0,
    range_sd_m=0.5,
    missing_share=0.1,
    outlier_share=0.05,
    outlier_m=20.0,
    lever_arm_m=(0.4, 0.1, -0.4),
)
USBL = replace(
    EVERY_SENSOR.usbl,
    ship_m=(60.0, -40.0),
    position_sd_m=0.5,
    bearing_sd_rad=0.01,
    missing_share=0.1,
    outlier_share=0.1,
    outlier_m=20.0,
    lever_arm_m=(0.0, 0.0, -0.4),
)
NONE_LOST = {"missing_share": 0.0, "outlier_share": 0.0}
PERFECT = {"range_sd_m": 1e-12, **NONE_LOST}


def path(t_s: float):
    """Return the truth at 4 m/s ahead in a turn of 0.4 rad/s: it changes the path of the sound by 2 m."""
    position, attitude = (4.0 * t_s, 1.0 + 0.5 * t_s, 20.0 + 0.2 * t_s), (0.0, 0.0, 0.4 * t_s)
    return truth(round(t_s * S), position_m=position, velocity_mps=(4.0, 0.5, 0.2), attitude_rad=attitude)


def head(t_s: float) -> np.ndarray:
    return np.array(path(t_s).position_m) + frames.rotation(0.0, 0.0, 0.4 * t_s) @ np.array(LBL.lever_arm_m)


@pytest.mark.parametrize("step_ns", [10 * MS, 70 * MS])
def test_the_sound_returns_to_where_the_vehicle_is_by_then(step_ns):
    """Half the time is, to a centimetre, the range at the message's own time, unlike that at the interrogation."""
    transceiver = AcousticTransceiver(replace(LBL, **PERFECT), 1)
    said, called_ns = [], 123 * MS
    for at in range(0, 3 * S, step_ns):
        motion = motion_between(path(at / S), path((at + step_ns) / S))
        if at < called_ns <= at + step_ns:
            assert transceiver.sample(motion.at(called_ns)) == []
        said += [(at + step_ns, message) for message in transceiver.answers(motion, at + step_ns)]
    c = transceiver.sound_speed_mps
    assert [message.transponder for _, message in said] == [1, 0]  # the near one first
    for at_ns, message in said:
        P = np.array(LBL.transponders_m[message.transponder])
        reached = 0.123 + np.linalg.norm(head(0.123) - P) / c
        # The sphere of sound that left the transponder then has the head on it
        home = brentq(lambda t, P=P, since=reached: c * (t - since) - np.linalg.norm(head(t) - P), 0.2, 3.0, xtol=1e-14)
        assert message.travel_time_s == pytest.approx(home - 0.123, abs=2e-9)
        assert message.t_ns == pytest.approx(0.5e9 * (0.123 + home), abs=5)
        assert transceiver.arrival_ns(message) == pytest.approx(home * 1e9, abs=5)
        assert at_ns - step_ns < home * 1e9 <= at_ns
        half = 0.5 * c * message.travel_time_s
        assert half == pytest.approx(np.linalg.norm(head(message.t_ns / S) - P), abs=0.01)
        assert abs(half - np.linalg.norm(head(0.123) - P)) > 0.1


def ranges(settings, count):
    """Return the sound speed and the measured minus true ranges of a vehicle at rest, (count, J)."""
    transceiver = AcousticTransceiver(settings, 1)
    heard = np.full((count, len(settings.transponders_m)), np.nan)
    still = motion_between(truth(0, position_m=(0.0, 0.0, 20.0)), truth(2 * S, position_m=(0.0, 0.0, 20.0)))
    for k in range(count):
        transceiver.sample(still.at(0))
        for message in transceiver.answers(still, 2 * S):
            heard[k, message.transponder] = message.travel_time_s
    c = transceiver.sound_speed_mps
    at = np.array([0.0, 0.0, 20.0]) + np.array(settings.lever_arm_m)
    return c, 0.5 * 1500.0 * (heard - np.array([2.0 * math.dist(at, P) / c for P in settings.transponders_m]))


def test_ranges_are_off_by_white_noise_and_sometimes_lost_or_longer_but_never_shorter():
    white = ranges(replace(LBL, **NONE_LOST), 3000)[1]
    check_white(white, 0.5)
    errors = ranges(LBL, 3000)[1]
    lost = np.isnan(errors)
    check_share(lost, 0.1)
    check_share(lost.all(axis=1), 0.01)
    detours = (errors - white)[~lost]  # no setting changes the noise
    longer = detours > 1e-6
    check_share(longer, 0.05)
    np.testing.assert_allclose(detours[~longer], 0.0, atol=1e-9)
    assert stats.kstest(detours[longer], stats.uniform(0.0, 20.0).cdf).pvalue > 1e-4


def test_the_sound_speed_differs_from_the_file_by_one_draw_a_run_that_stretches_every_range():
    check_white([AcousticTransceiver(LBL, seed).sound_speed_mps - 1500.0 for seed in range(600)], 2.0)
    assert AcousticTransceiver(replace(LBL, sound_speed_sd_mps=0.0), 5).sound_speed_mps == 1500.0
    c, errors = ranges(replace(LBL, **PERFECT, sound_speed_sd_mps=30.0), 3)
    assert abs(c - 1500.0) > 5.0
    np.testing.assert_allclose(errors, 0.0, atol=1e-6)


def test_no_range_with_the_head_out_of_water_or_from_a_far_transponder():
    out = AcousticTransceiver(LBL, 1)
    world = motion_between(truth(0, position_m=(0.0, 0.0, 0.3)), truth(S, position_m=(0.0, 0.0, 0.3)))
    out.sample(world.at(0))  # 0.4 m above the origin, at 0.3 m
    assert out.answers(world, S) == []
    far = replace(LBL, **PERFECT, transponders_m=((46_000.0, 0.0, 60.0), (100.0, 0.0, 60.0)))
    transceiver = AcousticTransceiver(far, 1)
    transceiver.sample(instant(position=(0.0, 0.0, 20.0)))
    at = [truth(k * S, position_m=(0.0, 0.0, 20.0)) for k in range(70)]
    said = [x for a, b in pairwise(at) for x in transceiver.answers(motion_between(a, b), b.t_ns)]
    assert [message.transponder for message in said] == [1]


def fixes(settings, count, depth):
    """Return the errors of fixes of a vehicle at a depth, (count, 2); NaN: none."""
    ship, rows = ShipTransceiver(settings, 2), np.full((count, 2), np.nan)
    for k in range(count):
        for fix in ship.sample(instant(k, position=(10.0, 20.0, depth))):
            assert fix.t_ns == k
            rows[k] = fix.north_m - 10.0, fix.east_m - 20.0
    return rows


@pytest.mark.parametrize("depth", [20.0, 900.0])
def test_the_error_of_a_fix_grows_with_the_distance_of_the_ship(depth):
    sd = math.sqrt(0.5**2 + (0.01**2) * (50.0**2 + 60.0**2 + (depth - 0.4) ** 2))
    check_white(fixes(replace(USBL, **NONE_LOST), 3000, depth), sd)


def test_a_fix_is_the_position_of_the_beacon():
    quiet = replace(USBL, position_sd_m=1e-12, bearing_sd_rad=0.0, **NONE_LOST)
    ship = ShipTransceiver(replace(quiet, lever_arm_m=(0.0, 0.0, -2.0)), 2)
    (fix,) = ship.sample(instant(position=(10.0, 20.0, 20.0), attitude=(0.0, 0.1, 0.0)))
    assert (fix.north_m, fix.east_m) == pytest.approx((10.0 - 2.0 * math.sin(0.1), 20.0))


def test_lost_fixes_and_outliers_have_their_shares():
    error = fixes(replace(USBL, position_sd_m=1e-9, bearing_sd_rad=0.0), 1000, 20.0)
    lost = np.isnan(error).any(axis=1)
    check_share(lost, 0.1)
    for sign in (1, -1):
        check_share(np.abs(error[~lost] - 20.0 * sign) < 1e-6, 0.05)
    check_share(np.abs(error[~lost]) < 1e-6, 0.9)


def test_a_beacon_out_of_the_water_gives_no_fix():
    always = replace(USBL, missing_share=0.0)
    assert np.isnan(fixes(always, 20, 0.4)).all()
    assert np.isfinite(fixes(always, 20, 0.41)).all()
