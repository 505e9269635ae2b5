"""Reinitialisation of a diverged filter: its start, its uncertainty, and its report."""

import math

import numpy as np
import pytest
from msgspec.structs import replace

from ltv_mpc.frames import rotation
from ltv_mpc.localisation.filter.state import Belief, Layout
from ltv_mpc.localisation.reinitialisation import (
    ACCELERATION_SD_MPS2,
    MAX_INCONSISTENT_NS,
    VELOCITY_SD_MPS,
    Reinitialisation,
)
from ltv_mpc.messages import CompassHeading, FilterStatus, GnssFix, ImuSample, PressureDepth
from tests.ltv_mpc.localisation.dives import CONFIG as SHIPPED
from tests.ltv_mpc.localisation.dives import REALISTIC, S, error_of, normalised
from tests.ltv_mpc.localisation.test_shadow_filter import BEGIN_NS, healthy, returns, run_with, the_dive

CONFIG = replace(SHIPPED, deepest_m=30.0, kept_m=5.0)
BAD, GOOD = FilterStatus.INCONSISTENT, FilterStatus.NOMINAL
NOW_S = 41
"""Bad from 31 s on: reinitialised after ten seconds; the window then was good at 21 s."""


def belief_at(t_s, sd_m=2.0):
    """Return the belief of a vehicle that moves north at 0.4 m/s and west at 0.1 m/s through the origin at t = 0."""
    belief = Belief.blank(Layout.of(REALISTIC, CONFIG), round(t_s * S))
    belief.x[:2], belief.x[3:5] = (0.4 * t_s, -0.1 * t_s), (0.4, -0.1)
    belief.P = np.diag(np.full(belief.layout.size, sd_m**2))
    return belief


def watched(*spans):
    """Return a reinitialisation after each second of (until, status), and when it first asked for a new filter."""
    restarts, t_s = Reinitialisation(REALISTIC, CONFIG, None), 0
    for until_s, status in spans:
        while t_s < until_s:
            t_s += 1
            if restarts.watch(belief_at(t_s), status):
                return restarts, t_s
    return restarts, None


def recent(now_s, yaw_rate_radps=0.0, tilt_rad=0.0):
    """Return the messages of the last 2.5 s of a vehicle with that roll; heading 1 rad at ``now_s``."""
    out, R = [], rotation(tilt_rad, 0.0, 0.0)
    force = tuple((R.T @ np.array([0.0, 0.0, -9.80665])).tolist())
    rate = tuple((R.T @ np.array([0.0, 0.0, yaw_rate_radps])).tolist())
    for k in range(250):
        t_ns = round(now_s * S) - 2_500_000_000 + (k + 1) * 10_000_000
        out.append(ImuSample(t_ns=t_ns, interval_ns=10_000_000, angular_rate_radps=rate, specific_force_mps2=force))
        if t_ns % 100_000_000 == 0:
            out.append(PressureDepth(t_ns=t_ns, depth_m=12.0))
        if (t_ns - 400_000_000) % S == 0:
            out.append(CompassHeading(t_ns=t_ns, heading_rad=1.0 + yaw_rate_radps * (t_ns * 1e-9 - now_s)))
    return out


def begun(messages):
    restarts, at_s = watched((30, GOOD), (60, BAD))
    assert at_s == NOW_S
    return restarts.begin(NOW_S * S, messages)


def test_reinitialisation_needs_ten_bad_seconds_in_a_row():
    assert watched((30, GOOD), (60, BAD))[1] == 31 + MAX_INCONSISTENT_NS // S
    assert watched((30, GOOD), (39, BAD), (40, GOOD), (60, BAD))[1] == 41 + MAX_INCONSISTENT_NS // S
    assert watched((30, GOOD), (40, BAD), (60, GOOD))[1] is None
    bad, _ = watched((30, GOOD), (35, BAD))
    assert (bad.is_inconsistent, bad.fork().is_inconsistent) == (True, False)


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
    """Begun at the heading of 40.4 s; recent satellite fixes do not replace the good position."""
    fix = GnssFix(t_ns=NOW_S * S - 10**8, north_m=99.0, east_m=99.0, velocity_north_mps=0.0, velocity_east_mps=0.0)
    alignment = begun([*recent(NOW_S), fix])
    assert alignment.waiting_for == ""
    belief, since = alignment.belief()
    assert belief.t_ns == 40_400_000_000
    np.testing.assert_allclose(belief.x[:3], [0.4 * 40.4, -0.1 * 40.4, 12.0], atol=1e-6)
    np.testing.assert_allclose(belief.x[3:6], [0.4, -0.1, 0.0], atol=1e-9)
    sd = np.sqrt(np.diagonal(belief.P))
    np.testing.assert_allclose(sd[:2], math.hypot(2.0, VELOCITY_SD_MPS * (40.4 - 21.0)), rtol=1e-3)
    np.testing.assert_allclose(sd[3:5], VELOCITY_SD_MPS, rtol=1e-3)
    assert np.linalg.eigvalsh(belief.P)[0] > -1e-12
    assert since[-1].t_ns == NOW_S * S
    assert all(m.t_ns > belief.t_ns for m in since)


def test_attitude_is_that_of_the_heading_and_of_the_accelerometers_at_one_instant():
    """Turning at 0.2 rad/s: a heading of half a second before or after would be 6 deg off."""
    belief, _ = begun(recent(NOW_S, yaw_rate_radps=0.2, tilt_rad=0.3)).belief()
    np.testing.assert_allclose(belief.R, rotation(0.3, 0.0, 1.0 - 0.2 * 0.6), atol=2e-3)
    tilt = math.hypot(ACCELERATION_SD_MPS2, REALISTIC.imu.accelerometer_bias_sd_mps2) / 9.80665
    np.testing.assert_allclose(np.sqrt(np.diagonal(belief.P)[6:8]), tilt, rtol=0.05)


def test_without_a_recent_heading_it_waits_for_one():
    alignment = begun([m for m in recent(NOW_S) if not isinstance(m, CompassHeading)])
    assert alignment.waiting_for == "compass"
    for message in recent(NOW_S + 2.5):
        alignment.take(message)
    assert alignment.waiting_for == ""
    assert alignment.belief()[0].t_ns == NOW_S * S


def test_an_estimator_whose_belief_is_corrupted_continues_at_the_next_estimate():
    """Not a number just before 20 s: reinitialised at 20 s, and no estimate is missing."""
    spoilt_ns, end_ns = 19_960_000_000, 24 * S
    run = healthy().continued(m for m in the_dive().messages if BEGIN_NS < m.t_ns <= spoilt_ns)
    run.estimator.filter.belief.x[0] = math.nan
    run.feed(m for m in the_dive().messages if spoilt_ns < m.t_ns <= end_ns)
    estimates, reports = run.estimates, run.reports
    assert all(math.isfinite(e.north_m) for e in estimates.values())
    assert list(estimates) == list(range(min(estimates), end_ns + 1, 100_000_000))
    assert reports[19 * S].status is FilterStatus.NOMINAL
    assert [reports[t * S].status for t in (20, 21, 24)] == [FilterStatus.RESTARTED] * 3
    assert reports[end_ns].restarts == 1
    assert normalised(estimates[end_ns], the_dive(), 4) < 18.5  # 99.9 % of chi-square of 4 degrees
    assert abs(error_of(estimates[end_ns], the_dive())[4]) < 3 * math.radians(2.5)
    account = run.estimator.account
    assert account["pressure.used"] + account["pressure.gate"] <= 10 * 25 + 1  # none is counted twice


def test_known_water_determines_the_velocity_after_a_reinitialisation():
    """An inertial unit is wrong by 20 mg and 4 deg/s for 5 s; reinitialised ten seconds after that began.

    The filter that was wrong does not take over.
    """
    run = run_with(wrong_unit)
    assert {report.restarts for report in run.reports.values()} == {0, 1}
    inconsistent_s = [t_ns // S for t_ns, report in run.reports.items() if report.status is FilterStatus.INCONSISTENT]
    assert 15 < min(inconsistent_s) <= 18
    sd = [run.estimates[t_s * S].covariance[2, 2] ** 0.5 for t_s in (14, 32)]
    assert sd[1] < 2.0 * sd[0]
    assert abs(error_of(run.estimates[32 * S], the_dive())[2:4]).max() < 3.5 * sd[1]
    assert not returns(run)


def wrong_unit(message):
    """Return the message of an inertial unit that is wrong from 15 to 20 s."""
    if not isinstance(message, ImuSample) or message.t_ns > 20 * S:
        return message
    rate = tuple(w + 0.07 for w in message.angular_rate_radps)
    force = tuple(f + 0.2 for f in message.specific_force_mps2)
    return replace(message, angular_rate_radps=rate, specific_force_mps2=force)


def test_a_second_reinitialisation_soon_after_the_first_has_no_known_water():
    """The water may have changed."""
    restarts, known = Reinitialisation(REALISTIC, CONFIG, None), belief_at(20.0)
    known.x[known.layout.north] = 0.3
    restarts.store(known)
    calls = [restarts.watch(belief_at(float(t_s)), GOOD if t_s <= 30 else BAD) for t_s in range(21, NOW_S + 1)]
    assert calls == [False] * 20 + [True]
    belief, _ = restarts.begin(NOW_S * S, recent(NOW_S)).belief()
    assert restarts.restore_water(belief)
    np.testing.assert_array_equal(belief.x[belief.layout.north], 0.3)
    again_s = NOW_S + 30
    restarts.store(known)
    restarts.watch(belief_at(float(again_s)), GOOD)
    belief, _ = restarts.begin(again_s * S, recent(again_s)).belief()
    assert not restarts.restore_water(belief)
    assert not belief.x[belief.layout.north].any()
