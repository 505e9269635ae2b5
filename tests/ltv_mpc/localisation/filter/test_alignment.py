"""Initial alignment: first estimate, covariance, and correlations between its errors."""

import math

import msgspec
import numpy as np
import pytest

from ltv_mpc.frames import GRAVITY_MPS2, roll_pitch_heading, rotation, rotation_exp, rotation_log
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.filter.alignment import Alignment
from ltv_mpc.localisation.filter.state import ACCELEROMETER_BIAS, ATTITUDE, GYRO_BIAS
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.messages import CompassHeading, GnssFix, ImuSample, PressureDepth
from tests.ltv_mpc.localisation.sensors.every_sensor import EVERY_SENSOR, with_settings

SUITE = SensorConfig.load("realistic")
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


def samples(first=1, count=21, bias=(0.0, 0.0, 0.0)):
    """Return IMU samples of a vehicle that rolls and turns at the surface without moving."""
    out = []
    for k in range(first, first + count):
        R = ATTITUDE_AT_T0 @ rotation_exp((k - 0.5) * 0.01 * RATE)
        f = R.T @ np.array([0, 0, -GRAVITY_MPS2]) + bias
        out.append(
            ImuSample(
                t_ns=T0 + k * DT_NS,
                interval_ns=DT_NS,
                angular_rate_radps=tuple(RATE.tolist()),
                specific_force_mps2=tuple(f.tolist()),
            )
        )
    return out


AT_FIX = [fix(), compass(), depth()]


def check_covariance(P):
    np.testing.assert_allclose(P, P.T, atol=1e-18)
    assert np.linalg.eigvalsh(P).min() > -1e-12  # the clone is the position itself


def taken(messages, suite=SUITE, config=CONFIG):
    alignment = Alignment(suite, config)
    for message in messages:
        alignment.take(message)
    return alignment


def aligned(messages, suite=SUITE, config=CONFIG):
    alignment = taken(messages, suite, config)
    assert not alignment.waiting_for
    return alignment.belief()


def test_missing_sensors_are_named():
    alignment = Alignment(SUITE, CONFIG)
    assert alignment.waiting_for == "gnss, compass, pressure"
    with pytest.raises(RuntimeError, match="waiting for gnss, compass, pressure"):
        alignment.belief()
    assert taken(AT_FIX).waiting_for == "imu"
    assert taken([*AT_FIX, *samples()]).waiting_for == ""


def test_the_belief_has_the_time_of_the_fix_and_the_measured_values():
    """Without rotating the samples back to t0 the tilt error would be half of 0.2 s of rolling: 5 mrad."""
    belief, since = aligned([*AT_FIX, *samples()])
    assert belief.t_ns == belief.epoch_t_ns == T0
    np.testing.assert_array_equal(belief.x[:6], [3.0, -4.0, 0.25, 0.1, -0.2, 0.0])
    np.testing.assert_array_equal(belief.x[belief.layout.epoch], [3.0, -4.0])
    np.testing.assert_allclose(roll_pitch_heading(belief.R), roll_pitch_heading(ATTITUDE_AT_T0), atol=1e-5)
    assert [m.t_ns for m in since] == [T0 + k * DT_NS for k in range(1, 22)]


@pytest.mark.parametrize("axis", [0, 1])
def test_tilt_error_is_correlated_with_the_accelerometer_bias(axis):
    """The attitude error equals its conditional mean given the bias, P_phi,b P_bb^-1 b."""
    bias = np.zeros(3)
    bias[axis] = 0.01
    belief, _ = aligned([*AT_FIX, *samples(bias=bias)])
    error = rotation_log(ATTITUDE_AT_T0 @ belief.R.T)
    P = belief.P
    expected = P[ATTITUDE, ACCELEROMETER_BIAS] @ np.linalg.solve(P[ACCELEROMETER_BIAS, ACCELEROMETER_BIAS], bias)
    assert np.abs(expected[:2]).max() == pytest.approx(0.01 / GRAVITY_MPS2, rel=0.4)
    np.testing.assert_allclose(error[:2], expected[:2], atol=3e-5)


def test_heading_error_is_correlated_with_the_compass_bias():
    bias = 0.03
    belief, _ = aligned([fix(), compass(heading=2.2 + bias), depth(), *samples()])
    error = rotation_log(ATTITUDE_AT_T0 @ belief.R.T)[2]
    c = belief.layout.compass_bias.start
    expected = belief.P[8, c] / belief.P[c, c] * bias
    assert error == pytest.approx(expected, rel=0.01)


def test_deviations_are_those_of_the_sensors_file():
    turned = (0.1, -0.05, 0.785)
    suite = with_settings(
        msgspec.structs.replace(SUITE, lbl=EVERY_SENSOR.lbl),
        lbl={"sound_speed_mps": 1480.0, "sound_speed_sd_mps": 2.96},
        adcp={"mounting_rad": turned},
    )
    belief, _ = aligned([*AT_FIX, *samples()], suite)
    layout, P = belief.layout, belief.P
    white = SUITE.imu.velocity_random_walk_mps_per_rts / math.sqrt(0.21)
    tilt = math.hypot(SUITE.imu.accelerometer_bias_sd_mps2, white, CONFIG.afloat_acceleration_sd_mps2) / GRAVITY_MPS2
    for states, sd in (
        (slice(0, 3), [5.0, 5.0, 0.01]),
        (slice(3, 5), 0.02),
        (slice(6, 8), tilt),
        (slice(8, 9), math.radians(math.hypot(1, 2))),
        (GYRO_BIAS, SUITE.imu.gyro_bias_sd_radps),
        (ACCELEROMETER_BIAS, SUITE.imu.accelerometer_bias_sd_mps2),
        (layout.beam_bias, 0.005),
        (layout.near_bias, 0.015),
        (layout.mounting, math.radians(0.3)),
        (layout.compass_bias, math.radians(2)),
        (layout.sound_speed, 0.002),
    ):
        np.testing.assert_allclose(np.sqrt(np.diag(P))[states], sd)
    np.testing.assert_array_equal(P[layout.epoch], P[:2])
    np.testing.assert_allclose(belief.mounting, rotation(*turned))
    check_covariance(P)


def test_heading_and_depth_of_the_alignment_are_not_used_again():
    """They are the first after the fix; one shortly before it is worse."""
    later = [compass(T0 + 100_000_000), depth(T0 + 100_000_000), depth(T0 + 150_000_000)]
    before = msgspec.structs.replace(depth(T0 - 50_000_000), depth_m=0.75)
    messages = sorted([fix(), before, *later, *samples()], key=lambda m: m.t_ns)
    belief, since = aligned(messages)
    assert belief.x[2] == 0.25
    assert not any(isinstance(m, CompassHeading) for m in since)
    assert [m.t_ns - T0 for m in since if isinstance(m, PressureDepth)] == [150_000_000]


def test_a_newer_fix_while_others_are_missing_starts_the_levelling_again():
    second = 1_000_000_000
    messages = [fix(), depth(), *samples(), fix(T0 + second, north=7.0), compass(T0 + second), depth(T0 + second)]
    alignment = taken(messages)
    assert alignment.waiting_for == "imu"
    for message in samples(first=101):
        alignment.take(message)
    belief, since = alignment.belief()
    assert (belief.t_ns, belief.x[0]) == (T0 + second, 7.0)
    assert since[0].t_ns == T0 + 101 * DT_NS


def test_a_fix_grows_too_old_while_others_are_missing():
    late = taken([fix(), depth(), *samples(count=600), compass(T0 + 6_000_000_000)])
    assert late.waiting_for.startswith("gnss")


def test_waves_make_the_level_less_certain_but_not_the_bias():
    rough = msgspec.structs.replace(CONFIG, afloat_acceleration_sd_mps2=0.5)
    calm, wild = (aligned([*AT_FIX, *samples()], config=c)[0].P for c in (CONFIG, rough))
    assert wild[6, 6] > 100 * calm[6, 6]
    np.testing.assert_array_equal(wild[ATTITUDE, ACCELEROMETER_BIAS], calm[ATTITUDE, ACCELEROMETER_BIAS])


MAST = with_settings(SUITE, gnss={"lever_arm_m": (2.0, 0.5, -3.0)}, pressure={"lever_arm_m": (-1.5, 0.2, 0.4)})


def test_position_and_velocity_are_the_origins_and_not_the_antennas():
    """Reference: position and motion of antenna and gauge, differentiated numerically."""
    suite = MAST
    R, v = ATTITUDE_AT_T0, np.array([0.1, -0.2, 0.0])

    def at(lever, t):
        return np.array([3.0, -4.0, 0.25]) + v * t + R @ rotation_exp(t * RATE) @ np.array(lever)

    antenna = at(suite.gnss.lever_arm_m, 0.0)
    moving = (at(suite.gnss.lever_arm_m, 1e-6) - at(suite.gnss.lever_arm_m, -1e-6)) / 2e-6
    seen = GnssFix(
        t_ns=T0, north_m=antenna[0], east_m=antenna[1], velocity_north_mps=moving[0], velocity_east_mps=moving[1]
    )
    pressed = PressureDepth(t_ns=T0, depth_m=at(suite.pressure.lever_arm_m, 0.0)[2])
    belief, _ = aligned([seen, compass(), pressed, *samples()], suite)
    np.testing.assert_allclose(belief.x[:6], [3.0, -4.0, 0.25, *v], atol=1e-4)
    np.testing.assert_allclose(belief.x[belief.layout.epoch], antenna[:2])


def test_position_and_velocity_errors_from_tilt_heading_and_gyro_bias_are_in_the_covariance():
    """They equal their conditional means given the biases; the gyros' make the velocity error R (db x l)."""
    suite = MAST
    accelerometer, compass_bias = np.array([2e-3, -3e-3, 0.0]), 4e-3
    messages = [*AT_FIX, *samples()]
    wrong = [fix(), compass(heading=2.2 + compass_bias), depth(), *samples(bias=accelerometer)]
    true, belief = aligned(messages, suite)[0], aligned(wrong, suite)[0]
    layout, P = belief.layout, belief.P
    causes = [*range(ACCELEROMETER_BIAS.start, ACCELEROMETER_BIAS.stop), layout.compass_bias.start]
    expected = P[:6, causes] @ np.linalg.solve(P[np.ix_(causes, causes)], [*accelerometer, compass_bias])
    np.testing.assert_allclose(true.x[:6] - belief.x[:6], expected, atol=5e-5)
    assert np.abs(expected[:2]).min() > 5e-3
    by_gyros = belief.R @ np.cross(np.eye(3), suite.gnss.lever_arm_m).T * suite.imu.gyro_bias_sd_radps**2
    np.testing.assert_allclose(P[3:5, GYRO_BIAS], by_gyros[:2], rtol=1e-9)
    check_covariance(P)


def test_a_receiver_faster_than_the_levelling_does_not_keep_the_filter_from_starting():
    """Ten fixes a second."""
    often = [fix(T0 + k * 100_000_000) for k in range(10)]
    messages = sorted(
        [*often, compass(), depth(), *samples(count=90)], key=lambda m: (m.t_ns, isinstance(m, ImuSample))
    )
    alignment = Alignment(SUITE, CONFIG)
    for message in messages:
        alignment.take(message)
        if not alignment.waiting_for:
            break
    belief, since = alignment.belief()
    assert belief.t_ns == T0
    assert sum(isinstance(m, GnssFix) for m in since) == 2


def test_a_message_from_the_future_does_not_keep_the_filter_from_starting():
    """One sensor has a wrong clock: messages with correct times are kept."""
    belief, since = aligned([depth(T0 + 3_600_000_000_000), fix(), compass(), depth(), *samples()])
    assert belief.x[2] == 0.25
    assert len(since) == 22


def test_without_an_inertial_unit_messages_do_not_pile_up():
    _, since = aligned([fix(), *(depth(T0 + k) for k in range(6100)), compass(T0 + 6100), *samples(first=100)])
    assert len(since) == 6000 - 2  # all but heading and depth of the alignment
