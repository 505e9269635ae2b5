"""How the filter starts: where it believes to be, and which of its errors it knows to be one."""

import math

import msgspec
import numpy as np
import pytest

from ltv_mpc.frames import GRAVITY_MPS2, roll_pitch_heading, rotation, rotation_exp, rotation_log
from ltv_mpc.localisation.alignment import Alignment
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.state import ACCELEROMETER_BIAS, ATTITUDE, GYRO_BIAS
from ltv_mpc.localisation.suite import Suite
from ltv_mpc.signals import CompassHeading, GnssFix, ImuSample, PressureDepth

SUITE = Suite.load("realistic")
CONFIG = EstimatorConfig()
T0 = -1_000_000_000
DT_NS = 10_000_000
ATTITUDE_AT_T0 = rotation(0.03, -0.05, 2.2)
RATE = np.array([0.05, -0.03, 0.02])


def fix(t_ns=T0, north=3.0):
    return GnssFix(t_ns=t_ns, north_m=north, east_m=-4.0, velocity_north_mps=0.1, velocity_east_mps=-0.2)


def compass(t_ns=T0, heading=2.2):
    return CompassHeading(t_ns=t_ns, heading_rad=heading)


def depth(t_ns=T0):
    return PressureDepth(t_ns=t_ns, depth_m=0.25)


def samples(first=1, count=21, bias=(0.0, 0.0, 0.0), t0=T0):
    """A vehicle that rolls and turns afloat without moving."""
    out = []
    for k in range(first, first + count):
        R = ATTITUDE_AT_T0 @ rotation_exp((k - 0.5) * 0.01 * RATE)
        f = R.T @ np.array([0, 0, -GRAVITY_MPS2]) + bias
        out.append(
            ImuSample(
                t_ns=t0 + k * DT_NS,
                interval_ns=DT_NS,
                angular_rate_radps=tuple(RATE.tolist()),
                specific_force_mps2=tuple(f.tolist()),
            )
        )
    return out


def aligned(messages, suite=SUITE, config=CONFIG):
    alignment = Alignment(suite, config)
    for message in messages:
        alignment.take(message)
    assert not alignment.waiting_for
    return alignment.belief()


def test_it_says_what_it_waits_for():
    alignment = Alignment(SUITE, CONFIG)
    assert alignment.waiting_for == "gnss, compass, pressure"
    with pytest.raises(RuntimeError, match="waiting for gnss, compass, pressure"):
        alignment.belief()
    for message in (fix(), compass(), depth()):
        alignment.take(message)
    assert alignment.waiting_for == "imu"
    for message in samples():
        alignment.take(message)
    assert alignment.waiting_for == ""


def test_the_belief_stands_at_the_fix_with_what_each_sensor_said():
    belief, since = aligned([fix(), compass(), depth(), *samples()])
    assert belief.t_ns == belief.epoch_t_ns == T0
    np.testing.assert_array_equal(belief.x[:6], [3.0, -4.0, 0.25, 0.1, -0.2, 0.0])
    np.testing.assert_array_equal(belief.x[belief.layout.epoch], [3.0, -4.0])
    assert [m.t_ns for m in since] == [T0 + k * DT_NS for k in range(1, 22)]


def test_a_vehicle_that_rolls_is_levelled_at_the_time_of_the_fix():
    """Without turning the samples back the tilt would be half of 0.2 s of rolling: 5 mrad."""
    belief, _ = aligned([fix(), compass(), depth(), *samples()])
    np.testing.assert_allclose(roll_pitch_heading(belief.R), roll_pitch_heading(ATTITUDE_AT_T0), atol=1e-5)


@pytest.mark.parametrize("axis", [0, 1])
def test_a_tilt_that_comes_from_an_accelerometer_bias_is_known_to_come_from_it(axis):
    """The error of the attitude is the one that the covariance expects of that bias: P_phi,b P_bb^-1 b."""
    bias = np.zeros(3)
    bias[axis] = 0.01
    belief, _ = aligned([fix(), compass(), depth(), *samples(bias=bias)])
    error = rotation_log(ATTITUDE_AT_T0 @ belief.R.T)
    P = belief.P
    expected = P[ATTITUDE, ACCELEROMETER_BIAS] @ np.linalg.solve(P[ACCELEROMETER_BIAS, ACCELEROMETER_BIAS], bias)
    assert np.abs(expected[:2]).max() == pytest.approx(0.01 / GRAVITY_MPS2, rel=0.4)
    np.testing.assert_allclose(error[:2], expected[:2], atol=3e-5)


def test_a_heading_that_comes_from_a_compass_bias_is_known_to_come_from_it():
    bias = 0.03
    belief, _ = aligned([fix(), compass(heading=2.2 + bias), depth(), *samples()])
    error = rotation_log(ATTITUDE_AT_T0 @ belief.R.T)[2]
    c = belief.layout.compass_bias.start
    expected = belief.P[8, c] / belief.P[c, c] * bias
    assert error == pytest.approx(expected, rel=0.01)


def test_deviations_are_those_of_the_sensors_file():
    belief, _ = aligned([fix(), compass(), depth(), *samples()])
    layout, P = belief.layout, belief.P
    deviation = np.sqrt(np.diag(P))
    np.testing.assert_allclose(deviation[:3], [5.0, 5.0, 0.01])
    np.testing.assert_allclose(deviation[3:5], 0.02)
    white = SUITE.imu.velocity_random_walk_mps_per_rts / math.sqrt(0.21)
    tilt = math.hypot(SUITE.imu.accelerometer_bias_sd_mps2, white, CONFIG.afloat_acceleration_sd_mps2) / GRAVITY_MPS2
    np.testing.assert_allclose(deviation[6:8], tilt)
    assert deviation[8] == pytest.approx(math.radians(math.hypot(1, 2)))
    np.testing.assert_allclose(deviation[GYRO_BIAS], SUITE.imu.gyro_bias_sd_radps)
    np.testing.assert_allclose(deviation[ACCELEROMETER_BIAS], SUITE.imu.accelerometer_bias_sd_mps2)
    np.testing.assert_allclose(deviation[layout.beam_bias], 0.005)
    np.testing.assert_allclose(deviation[layout.near_bias], 0.015)
    np.testing.assert_allclose(deviation[layout.mounting], math.radians(0.3))
    np.testing.assert_allclose(deviation[layout.compass_bias], math.radians(2))
    np.testing.assert_array_equal(P[layout.epoch], P[:2])
    np.testing.assert_allclose(P, P.T, atol=1e-18)
    assert np.linalg.eigvalsh(P).min() > -1e-12  # the clone is the position itself


def test_the_heading_and_depth_that_made_the_belief_do_not_correct_it_too():
    later = [compass(T0 + 100_000_000), depth(T0 + 100_000_000), depth(T0 + 150_000_000)]
    messages = sorted([fix(), *later, *samples()], key=lambda m: m.t_ns)
    belief, since = aligned(messages)
    assert belief.x[2] == 0.25
    assert not any(isinstance(m, CompassHeading) for m in since)
    assert [m.t_ns - T0 for m in since if isinstance(m, PressureDepth)] == [150_000_000]


def test_a_newer_fix_while_others_are_missing_starts_the_levelling_again():
    second = 1_000_000_000
    messages = [fix(), depth(), *samples(), fix(T0 + second, north=7.0), compass(T0 + second), depth(T0 + second)]
    alignment = Alignment(SUITE, CONFIG)
    for message in messages:
        alignment.take(message)
    assert alignment.waiting_for == "imu"
    for message in samples(first=101):
        alignment.take(message)
    belief, since = alignment.belief()
    assert (belief.t_ns, belief.x[0]) == (T0 + second, 7.0)
    assert since[0].t_ns == T0 + 101 * DT_NS


def test_a_fix_grows_too_old_while_others_are_missing():
    alignment = Alignment(SUITE, CONFIG)
    for message in (fix(), depth(), *samples(count=600)):
        alignment.take(message)
    alignment.take(compass(T0 + 6_000_000_000))
    assert alignment.waiting_for.startswith("gnss")


def test_waves_make_the_level_less_certain_but_not_the_bias():
    rough = msgspec.structs.replace(CONFIG, afloat_acceleration_sd_mps2=0.5)
    calm, wild = (aligned([fix(), compass(), depth(), *samples()], config=c)[0].P for c in (CONFIG, rough))
    assert wild[6, 6] > 100 * calm[6, 6]
    np.testing.assert_array_equal(wild[ATTITUDE, ACCELEROMETER_BIAS], calm[ATTITUDE, ACCELEROMETER_BIAS])
