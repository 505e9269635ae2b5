"""Simulated LBL and USBL: travel times against a root finder on the true path, statistics against their tables."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
from scipy import stats
from scipy.optimize import brentq

from ltv_mpc import frames
from ltv_mpc.localisation.sensors.lbl import Lbl
from ltv_mpc.localisation.sensors.usbl import Usbl
from ltv_mpc.messages import Truth
from sim.sensors.lbl import AcousticTransceiver
from sim.sensors.usbl import ShipTransceiver
from sim.sensors.vehicle_state import VehicleState, motion_between

MS, S = 1_000_000, 1_000_000_000
LBL = Lbl(
    period_ns=10 * S,
    transponders_m=((400.0, 0.0, 60.0), (-75.0, 130.0, 80.0)),
    sound_speed_mps=1500.0,
    sound_speed_sd_mps=2.0,
    range_sd_m=0.5,
    missing_share=0.1,
    outlier_share=0.05,
    outlier_m=20.0,
    lever_arm_m=(0.4, 0.1, -0.4),
)
USBL = Usbl(
    period_ns=2 * S,
    latency_ns=800 * MS,
    ship_m=(60.0, -40.0),
    position_sd_m=0.5,
    bearing_sd_rad=0.01,
    missing_share=0.1,
    outlier_share=0.1,
    outlier_m=20.0,
    lever_arm_m=(0.0, 0.0, -0.4),
)
PERFECT = {"range_sd_m": 1e-12, "missing_share": 0.0, "outlier_share": 0.0}


def truth(t_ns, *, position=(0.0, 0.0, 20.0), velocity=(0.0, 0.0, 0.0), heading=0.0) -> Truth:
    return Truth(
        t_ns=t_ns,
        position_m=position,
        velocity_mps=velocity,
        attitude_rad=(0.0, 0.0, heading),
        water_velocity_mps=(0.0, 0.0, 0.0),
        yaw_rate_radps=0.0,
        current_mps=(0.0, 0.0),
        thrust_N=(0.0, 0.0, 0.0),
    )


def path(t_s: float) -> Truth:
    """Return the truth at 4 m/s ahead in a turn of 0.4 rad/s: it changes the path of the sound by 2 m."""
    position = (4.0 * t_s, 1.0 + 0.5 * t_s, 20.0 + 0.2 * t_s)
    return truth(round(t_s * S), position=position, velocity=(4.0, 0.5, 0.2), heading=0.4 * t_s)


def head(t_s: float) -> np.ndarray:
    world = path(t_s)
    return np.array(world.position_m) + frames.rotation(0.0, 0.0, 0.4 * t_s) @ np.array(LBL.lever_arm_m)


def said_along(settings, *, seed=1, step_ns=10 * MS, until_s=3.0):
    """Return (time of publication, message) of all ranges after an interrogation at t = 0.123 s."""
    transceiver = AcousticTransceiver(settings, seed)
    said = []
    called_ns = 123 * MS
    for at in range(0, round(until_s * S), step_ns):
        motion = motion_between(path(at / S), path((at + step_ns) / S))
        if at < called_ns <= at + step_ns:
            assert transceiver.sample(motion.at(called_ns)) == []
        said += [(at + step_ns, message) for message in transceiver.answers(motion, at + step_ns)]
    return transceiver, said


@pytest.mark.parametrize("step_ns", [10 * MS, 70 * MS])
def test_the_sound_returns_to_where_the_vehicle_is_by_then(step_ns):
    transceiver, said = said_along(msgspec.structs.replace(LBL, **PERFECT), step_ns=step_ns)
    c = transceiver.sound_speed_mps
    assert len(said) == 2
    for at_ns, message in said:
        P = np.array(LBL.transponders_m[message.transponder])
        reached = 0.123 + np.linalg.norm(head(0.123) - P) / c
        # The sphere of sound that left the transponder then has the head on it
        home = brentq(lambda t, P=P, since=reached: c * (t - since) - np.linalg.norm(head(t) - P), 0.2, 3.0, xtol=1e-14)
        assert message.travel_time_s == pytest.approx(home - 0.123, abs=2e-9)
        assert message.t_ns == pytest.approx(0.5e9 * (0.123 + home), abs=5)
        assert transceiver.arrival_ns(message) == pytest.approx(home * 1e9, abs=5)
        assert at_ns - step_ns < home * 1e9 <= at_ns
    near, far = said[0][1], said[1][1]
    assert (near.transponder, far.transponder) == (1, 0)


def test_half_the_time_is_the_range_at_the_messages_own_time():
    """The filter's model is correct to a centimetre at 4 m/s, unlike the range at the interrogation."""
    transceiver, said = said_along(msgspec.structs.replace(LBL, **PERFECT))
    for _, message in said:
        P = np.array(LBL.transponders_m[message.transponder])
        half = 0.5 * transceiver.sound_speed_mps * message.travel_time_s
        assert half == pytest.approx(np.linalg.norm(head(message.t_ns / S) - P), abs=0.01)
        assert abs(half - np.linalg.norm(head(0.123) - P)) > 0.1


def calls(settings, count, *, seed=1):
    """Return the transceiver of a vehicle at rest, its travel times (count, J), and which of them are outliers."""
    transceiver = AcousticTransceiver(settings, seed)
    heard = np.full((count, len(settings.transponders_m)), np.nan)
    wild = np.zeros_like(heard, dtype=bool)
    still = motion_between(truth(0), truth(2 * S))
    for k in range(count):
        transceiver.sample(still.at(0))
        for message in transceiver.answers(still, 2 * S):
            heard[k, message.transponder] = message.travel_time_s
            wild[k, message.transponder] = bool(transceiver.outlier_masks.at(message.t_ns)[0])
    return transceiver, heard, wild


def true_times(settings, c):
    at = np.array([0.0, 0.0, 20.0]) + np.array(settings.lever_arm_m)
    return np.array([2.0 * math.dist(at, P) / c for P in settings.transponders_m])


def test_ranges_are_off_by_white_noise_of_the_tables_size():
    settings = msgspec.structs.replace(LBL, missing_share=0.0, outlier_share=0.0)
    transceiver, heard, _ = calls(settings, 3000)
    z = 0.5 * 1500.0 * (heard - true_times(settings, transceiver.sound_speed_mps)) / 0.5
    low, high = stats.chi2.ppf([1e-5, 1 - 1e-5], z.size)
    assert low < (z**2).sum() < high
    assert abs(z.mean()) < 4.5 / math.sqrt(z.size)
    for product in (z[1:] * z[:-1], z[:, 1:] * z[:, :-1]):
        assert abs(product.mean()) < 4.5 / math.sqrt(product.size)


def test_the_sound_speed_differs_from_the_file_by_one_draw_a_run():
    c = np.array([AcousticTransceiver(LBL, seed).sound_speed_mps for seed in range(600)])
    low, high = stats.chi2.ppf([1e-5, 1 - 1e-5], 600)
    assert low < (((c - 1500.0) / 2.0) ** 2).sum() < high
    assert AcousticTransceiver(msgspec.structs.replace(LBL, sound_speed_sd_mps=0.0), 5).sound_speed_mps == 1500.0
    # and every range of the run is stretched by it
    settings = msgspec.structs.replace(LBL, **PERFECT, sound_speed_sd_mps=30.0)
    transceiver, heard, _ = calls(settings, 3)
    assert abs(transceiver.sound_speed_mps - 1500.0) > 5.0
    stretch = heard / true_times(settings, 1500.0)
    np.testing.assert_allclose(stretch, 1500.0 / transceiver.sound_speed_mps, rtol=1e-9)


def test_a_tenth_of_the_answers_is_lost_and_a_twentieth_longer_but_never_shorter():
    settings = msgspec.structs.replace(LBL, range_sd_m=1e-9)
    transceiver, heard, wild = calls(settings, 3000)
    lost = np.isnan(heard)
    assert lost.mean() == pytest.approx(0.1, abs=4.5 * math.sqrt(0.09 / lost.size))
    assert (lost[:, 0] & lost[:, 1]).mean() == pytest.approx(0.01, abs=4.5 * math.sqrt(0.01 / 3000))
    longer = 0.5 * 1500.0 * (heard - true_times(settings, transceiver.sound_speed_mps))[~lost]
    assert wild[~lost].mean() == pytest.approx(0.05, abs=4.5 * math.sqrt(0.05 / longer.size))
    np.testing.assert_allclose(longer[~wild[~lost]], 0.0, atol=1e-6)
    detours = longer[wild[~lost]]
    assert stats.kstest(detours, stats.uniform(0.0, 20.0).cdf).pvalue > 1e-4


def test_no_range_with_the_head_out_of_water_or_from_a_far_transponder():
    out = AcousticTransceiver(LBL, 1)
    world = motion_between(truth(0, position=(0.0, 0.0, 0.3)), truth(S, position=(0.0, 0.0, 0.3)))
    out.sample(world.at(0))  # 0.4 m above the origin, at 0.3 m
    assert out.answers(world, S) == []
    far = msgspec.structs.replace(LBL, **PERFECT, transponders_m=((46_000.0, 0.0, 60.0), (100.0, 0.0, 60.0)))
    transceiver = AcousticTransceiver(far, 1)
    transceiver.sample(motion_between(truth(0), truth(S)).at(0))
    motions = [motion_between(truth(k * S), truth((k + 1) * S)) for k in range(70)]
    said = [x for motion in motions for x in transceiver.answers(motion, motion.later.t_ns)]
    assert [message.transponder for message in said] == [1]


def fixes(settings, count, now, *, seed=2):
    ship = ShipTransceiver(settings, seed)
    rows, wild = np.full((count, 2), np.nan), np.zeros((count, 2), dtype=bool)
    for k in range(count):
        for fix in ship.sample(msgspec.structs.replace(now, t_ns=k)):
            assert fix.t_ns == k
            rows[k] = fix.north_m, fix.east_m
            wild[k] = ship.outlier_masks.at(k)
    return rows, wild


def at_depth(depth: float, pitch: float = 0.0) -> VehicleState:
    return VehicleState(0, (10.0, 20.0, depth), (0.3, 0.0, 0.0), frames.rotation(0.0, pitch, 0.0), np.zeros(3), 0.0)


@pytest.mark.parametrize("depth", [20.0, 900.0])
def test_the_error_of_a_fix_grows_with_the_distance_of_the_ship(depth):
    settings = msgspec.structs.replace(USBL, missing_share=0.0, outlier_share=0.0)
    rows, _ = fixes(settings, 3000, at_depth(depth))
    sd = math.sqrt(0.5**2 + (0.01**2) * (50.0**2 + 60.0**2 + (depth - 0.4) ** 2))
    z = (rows - [10.0, 20.0]) / sd
    low, high = stats.chi2.ppf([1e-5, 1 - 1e-5], 3000)
    assert ((low < (z**2).sum(axis=0)) & ((z**2).sum(axis=0) < high)).all()
    assert np.abs(z.mean(axis=0)).max() < 4.5 / math.sqrt(3000)
    assert abs((z[:, 0] * z[:, 1]).mean()) < 4.5 / math.sqrt(3000)
    assert np.abs((z[1:] * z[:-1]).mean(axis=0)).max() < 4.5 / math.sqrt(3000)


def test_a_fix_is_the_position_of_the_beacon():
    quiet = msgspec.structs.replace(USBL, position_sd_m=1e-12, bearing_sd_rad=0.0, missing_share=0.0, outlier_share=0.0)
    rows, _ = fixes(msgspec.structs.replace(quiet, lever_arm_m=(0.0, 0.0, -2.0)), 1, at_depth(20.0, pitch=0.1))
    np.testing.assert_allclose(rows, [[10.0 - 2.0 * math.sin(0.1), 20.0]])


def test_lost_fixes_and_outliers_have_their_shares():
    settings = msgspec.structs.replace(USBL, position_sd_m=1e-9, bearing_sd_rad=0.0)
    rows, wild = fixes(settings, 1000, at_depth(20.0))
    lost = np.isnan(rows).any(axis=1)
    assert lost.mean() == pytest.approx(0.1, abs=4.5 * math.sqrt(0.09 / 1000))
    error = (rows - [10.0, 20.0])[~lost]
    np.testing.assert_allclose(np.abs(error), 20.0 * wild[~lost], atol=1e-6)
    for sign in (1, -1):
        share = (error * sign > 10.0).mean()
        assert share == pytest.approx(0.05, abs=4.5 * math.sqrt(0.05 / error.size))


def test_a_beacon_out_of_the_water_gives_no_fix():
    rows, _ = fixes(msgspec.structs.replace(USBL, missing_share=0.0), 20, at_depth(0.4))
    assert np.isnan(rows).all()
    rows, _ = fixes(msgspec.structs.replace(USBL, missing_share=0.0), 20, at_depth(0.41))
    assert np.isfinite(rows).all()
