"""Reinitialisation of a diverged filter: its start, its uncertainty, and its report."""

import math

import msgspec
import numpy as np
import pytest

from ltv_mpc.frames import rotation
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.estimator import Estimator
from ltv_mpc.localisation.filter.state import Belief, Layout
from ltv_mpc.localisation.reinitialisation import (
    ACCELERATION_SD_MPS2,
    MAX_INCONSISTENT_NS,
    RESTARTED_NS,
    VELOCITY_SD_MPS,
    Reinitialisation,
)
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.sensors.compass import heading
from ltv_mpc.messages import (
    CompassHeading,
    Estimate,
    FilterStatus,
    GnssFix,
    ImuSample,
    LocalisationReport,
    PressureDepth,
)

SUITE = SensorConfig.load("realistic")
CONFIG = msgspec.structs.replace(EstimatorConfig(), deepest_m=30.0, kept_m=5.0)
SECOND = 1_000_000_000
BAD, GOOD = FilterStatus.INCONSISTENT, FilterStatus.NOMINAL


def belief_at(t_s, sd_m=2.0):
    """Return the belief of a vehicle that moves north at 0.4 m/s and west at 0.1 m/s through the origin at t = 0."""
    belief = Belief.blank(Layout.of(SUITE, CONFIG), round(t_s * SECOND))
    belief.x[:2], belief.x[3:5] = (0.4 * t_s, -0.1 * t_s), (0.4, -0.1)
    belief.P = np.diag(np.full(belief.layout.size, sd_m**2))
    return belief


def watched(*spans):
    """Return a reinitialisation after each second of (until, status), and when it first asked for a new filter."""
    restarts, t_s = Reinitialisation(SUITE, CONFIG, None), 0
    for until_s, status in spans:
        while t_s < until_s:
            t_s += 1
            if restarts.watch(belief_at(t_s), status):
                return restarts, t_s
    return restarts, None


def recent(now_s, yaw_rate_radps=0.0, tilt_rad=0.0):
    """Return the messages of the last 2.5 s of a vehicle with that roll; heading 1 rad at ``now_s``."""
    out = []
    R = rotation(tilt_rad, 0.0, 0.0)
    force = tuple((R.T @ np.array([0.0, 0.0, -9.80665])).tolist())
    rate = tuple((R.T @ np.array([0.0, 0.0, yaw_rate_radps])).tolist())
    for k in range(250):
        t_ns = round(now_s * SECOND) - 2_500_000_000 + (k + 1) * 10_000_000
        psi = 1.0 + yaw_rate_radps * (t_ns * 1e-9 - now_s)
        out.append(ImuSample(t_ns=t_ns, interval_ns=10_000_000, angular_rate_radps=rate, specific_force_mps2=force))
        if t_ns % 100_000_000 == 0:
            out.append(PressureDepth(t_ns=t_ns, depth_m=12.0))
        if (t_ns - 400_000_000) % SECOND == 0:
            out.append(CompassHeading(t_ns=t_ns, heading_rad=psi))
    return out


def test_reinitialisation_needs_ten_bad_seconds_in_a_row():
    assert watched((30, GOOD), (60, BAD))[1] == 31 + MAX_INCONSISTENT_NS // SECOND
    assert watched((30, GOOD), (39, BAD), (40, GOOD), (60, BAD))[1] == 41 + MAX_INCONSISTENT_NS // SECOND
    assert watched((30, GOOD), (40, BAD), (60, GOOD))[1] is None


@pytest.mark.parametrize("spoil", ["position", "covariance", "variance", "innovations"])
def test_a_belief_that_is_not_finite_or_not_definite_is_replaced_at_once(spoil):
    restarts, _ = watched((20, GOOD))
    belief = belief_at(21)
    if spoil == "position":
        belief.x[0] = math.nan
    elif spoil == "covariance":
        belief.P[3, 40] = math.inf
    elif spoil == "variance":
        belief.P[7, 7] = -1e-9
    assert restarts.watch(belief, GOOD, broken=spoil == "innovations")


def test_reinitialisation_starts_from_the_last_good_second_with_its_uncertainty():
    """Bad from 31 s on: the window then was good at 21 s; begun at the heading of 40.4 s."""
    restarts, at_s = watched((30, GOOD), (60, BAD))
    alignment = restarts.begin(at_s * SECOND, recent(at_s))
    assert alignment.waiting_for == ""
    belief, since = alignment.belief()
    assert belief.t_ns == 40_400_000_000
    np.testing.assert_allclose(belief.x[:3], [0.4 * 40.4, -0.1 * 40.4, 12.0], atol=1e-6)
    np.testing.assert_allclose(belief.x[3:6], [0.4, -0.1, 0.0], atol=1e-9)
    sd = np.sqrt(np.diagonal(belief.P))
    np.testing.assert_allclose(sd[:2], math.hypot(2.0, VELOCITY_SD_MPS * (40.4 - 21.0)), rtol=1e-3)
    np.testing.assert_allclose(sd[3:5], VELOCITY_SD_MPS, rtol=1e-3)
    assert np.linalg.eigvalsh(belief.P)[0] > -1e-12
    assert since[-1].t_ns == at_s * SECOND
    assert all(m.t_ns > belief.t_ns for m in since)


def test_attitude_is_that_of_the_heading_and_of_the_accelerometers_at_one_instant():
    """Turning at 0.2 rad/s: a heading of half a second before or after would be 6 deg off."""
    restarts, at_s = watched((30, GOOD), (60, BAD))
    belief, _ = restarts.begin(at_s * SECOND, recent(at_s, yaw_rate_radps=0.2, tilt_rad=0.3)).belief()
    np.testing.assert_allclose(belief.R, rotation(0.3, 0.0, 1.0 - 0.2 * 0.6), atol=2e-3)
    tilt = math.hypot(ACCELERATION_SD_MPS2, SUITE.imu.accelerometer_bias_sd_mps2) / 9.80665
    np.testing.assert_allclose(np.sqrt(np.diagonal(belief.P)[6:8]), tilt, rtol=0.05)


def test_recent_satellite_fixes_do_not_replace_the_good_position():
    restarts, at_s = watched((30, GOOD), (60, BAD))
    fix = GnssFix(
        t_ns=at_s * SECOND - 100_000_000, north_m=99.0, east_m=99.0, velocity_north_mps=0.0, velocity_east_mps=0.0
    )
    belief, _ = restarts.begin(at_s * SECOND, [*recent(at_s), fix]).belief()
    assert belief.x[0] == pytest.approx(0.4 * 40.4)


def test_without_a_recent_heading_it_waits_for_one():
    restarts, at_s = watched((30, GOOD), (60, BAD))
    alignment = restarts.begin(at_s * SECOND, [m for m in recent(at_s) if not isinstance(m, CompassHeading)])
    assert alignment.waiting_for == "compass"
    for message in recent(at_s + 2.5):
        alignment.take(message)
    assert alignment.waiting_for == ""
    assert alignment.belief()[0].t_ns == at_s * SECOND


def test_it_is_reported_for_half_a_minute():
    restarts, at_s = watched((30, GOOD), (60, BAD))
    assert not restarts.recent(at_s * SECOND)
    restarts.begin(at_s * SECOND, recent(at_s))
    assert restarts.recent(at_s * SECOND + RESTARTED_NS - 1)
    assert not restarts.recent(at_s * SECOND + RESTARTED_NS)


@pytest.mark.parametrize("spoil", ["covariance", "position"])
def test_an_estimator_whose_belief_is_corrupted_continues_at_the_next_estimate(make_dive, inbox_of, spoil):
    """Not definite, or not a number, just before 20 s: reinitialised at 20 s, and no estimate is missing."""
    dive = make_dive(SUITE, 50, duration_s=24.0)
    estimator, out, spoilt = Estimator(SUITE, EstimatorConfig()), [], False
    for message in dive.messages:
        out += estimator.step(message.t_ns, inbox_of(message))
        if message.t_ns > 19_950_000_000 and not spoilt:
            spoilt = True
            if spoil == "covariance":
                estimator.filter.belief.P[3, 3] = -1.0
            else:
                estimator.filter.belief.x[0] = math.nan
    estimates = {s.t_ns: s for s in out if isinstance(s, Estimate)}
    reports = {s.t_ns: s for s in out if isinstance(s, LocalisationReport)}
    assert all(math.isfinite(s.north_m) for s in estimates.values())
    assert list(estimates) == list(range(min(estimates), 24 * SECOND + 1, 100_000_000))
    assert reports[19 * SECOND].status is FilterStatus.NOMINAL
    assert [reports[t * SECOND].status for t in (20, 21, 24)] == [FilterStatus.RESTARTED] * 3
    assert reports[24 * SECOND].restarts == 1

    last, k = estimates[24 * SECOND], dive.at(24 * SECOND)
    e = np.array([last.north_m, last.east_m, last.velocity_north_mps, last.velocity_east_mps])
    e -= np.concatenate([dive.position[k, :2], dive.velocity[k, :2]])
    assert e @ np.linalg.solve(last.covariance[:4, :4], e) < 18.5  # 99.9 % of chi-square of 4 degrees
    assert abs(math.remainder(last.heading_rad - heading(dive.R[k]), 2 * math.pi)) < 3 * math.radians(2.5)
    account = estimator.account
    assert account["pressure.used"] + account["pressure.gate"] <= 10 * 25 + 1  # none is counted twice


def test_known_water_determines_the_velocity_after_a_reinitialisation(make_dive, inbox_of):
    """An inertial unit is wrong by 20 mg and 4 deg/s for 5 s; reinitialised ten seconds after that began."""
    dive = make_dive(SUITE, 50, duration_s=32.0)
    estimator, sd, restarts = Estimator(SUITE, EstimatorConfig()), {}, set()
    for message in dive.messages:
        said = message
        if isinstance(message, ImuSample) and 15 * SECOND < message.t_ns <= 20 * SECOND:
            rate = tuple(w + 0.07 for w in message.angular_rate_radps)
            force = tuple(f + 0.2 for f in message.specific_force_mps2)
            said = msgspec.structs.replace(message, angular_rate_radps=rate, specific_force_mps2=force)
        out = estimator.step(message.t_ns, inbox_of(said))
        sd |= {one.t_ns: one.covariance[2, 2] ** 0.5 for one in out if isinstance(one, Estimate)}
        restarts |= {one.restarts for one in out if isinstance(one, LocalisationReport)}
    assert restarts == {0, 1}
    assert sd[32 * SECOND] < 2.0 * sd[14 * SECOND]
    k, x = dive.at(32 * SECOND), estimator.filter.belief.x
    assert abs(x[3:5] - dive.velocity[k, :2]).max() < 3.5 * sd[32 * SECOND]


def test_a_second_reinitialisation_soon_after_the_first_has_no_known_water():
    """The water may have changed."""
    restarts, at_s = Reinitialisation(SUITE, CONFIG, None), 41
    known = belief_at(20.0)
    known.x[known.layout.north] = 0.3
    restarts.store(known)
    called = [restarts.watch(belief_at(float(t_s)), GOOD if t_s <= 30 else BAD) for t_s in range(21, at_s + 1)]
    assert called == [False] * 20 + [True]
    belief, _ = restarts.begin(at_s * SECOND, recent(at_s)).belief()
    assert restarts.restore_water(belief)
    np.testing.assert_array_equal(belief.x[belief.layout.north], 0.3)
    again_s = at_s + 30
    restarts.store(known)
    restarts.watch(belief_at(float(again_s)), GOOD)
    belief, _ = restarts.begin(again_s * SECOND, recent(again_s)).belief()
    assert not restarts.restore_water(belief)
    assert not belief.x[belief.layout.north].any()
