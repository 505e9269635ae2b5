"""Ranges, fixes and bottom track bound the drift of dead reckoning; ranges to one transponder are consistent."""

import math
from functools import partial

import numpy as np
import pytest
from msgspec.structs import replace

from ltv_mpc.localisation.filter.error_state_filter import ErrorStateFilter
from ltv_mpc.localisation.filter.state import Belief, Layout
from ltv_mpc.messages import AdcpPing, BottomTrack, LblRange, UsblFix
from tests.ltv_mpc.localisation.dives import CONFIG as SHIPPED
from tests.ltv_mpc.localisation.dives import PAPER, REALISTIC, Run, S, dive, error_of
from tests.ltv_mpc.localisation.sensors.every_sensor import EVERY_SENSOR, with_settings

LBL = replace(
    EVERY_SENSOR.lbl,
    outlier_share=0.1,
    period_ns=5 * S,
    transponders_m=((150.0, 0.0, 60.0), (-75.0, 130.0, 60.0), (-75.0, -130.0, 60.0)),
    sound_speed_sd_mps=5.0,
    range_sd_m=0.5,
    outlier_m=200.0,
    lever_arm_m=(0.8, 0.0, -0.4),
)
USBL = replace(
    EVERY_SENSOR.usbl,
    outlier_share=0.1,
    period_ns=2 * S,
    latency_ns=800_000_000,
    ship_m=(60.0, -40.0),
    bearing_sd_rad=0.01,
    outlier_m=20.0,
    lever_arm_m=(-0.5, 0.2, -0.4),
)
TRACKING = replace(
    EVERY_SENSOR.bottom_track,
    missing_share=0.1,
    outlier_share=0.1,
    period_ns=S // 2,
    range_m=50.0,
    beam_noise_sd_mps=0.003,
    latency_ns=S // 10,
)
SENSORS = replace(REALISTIC, lbl=LBL, usbl=USBL, bottom_track=TRACKING)
CONFIG = replace(SHIPPED, deepest_m=5.0)


the_dive = partial(dive, SENSORS, 11, duration_s=60.0, bottom_m=40.0)
"""The dive of this file: made once, and not where only its tests are collected."""


LATENCY_NS = {UsblFix: USBL.latency_ns, BottomTrack: TRACKING.latency_ns}


def arrival_ns(message):
    """Return when a message arrives; a range does with the reply, half its travel time after it is valid."""
    if isinstance(message, LblRange):
        return message.t_ns + round(0.5e9 * message.travel_time_s)
    return message.t_ns + LATENCY_NS.get(type(message), 0)


def drifts(aid):
    """Return horizontal error (m) and its deviation for each second, with this aid alone, and the estimator."""
    others = {AdcpPing, LblRange, UsblFix, BottomTrack} - {aid}
    run = Run(sorted((m for m in the_dive().messages if type(m) not in others), key=arrival_ns), SENSORS, CONFIG)
    seconds = [estimate for t_ns, estimate in run.estimates.items() if t_ns > 0 and t_ns % S == 0]
    assert {e.altitude_m is None for e in seconds} == {aid is not BottomTrack}
    errors = [(math.hypot(*error_of(e, the_dive())[:2]), math.sqrt(np.trace(e.covariance[:2, :2]))) for e in seconds]
    return errors, run.estimator


def test_each_sensor_bounds_the_drift_of_dead_reckoning():
    """Ranges and fixes bound the position, bottom track the velocity."""
    # sensor, what it brings, deviation at the end: the sea bed does not mend the 5 m that the satellites left
    for sensor, aid, sd_m in (("lbl", LblRange, 1.5), ("usbl", UsblFix, 1.5), ("bottom_track", BottomTrack, 5.2)):
        errors, estimator = drifts(aid)
        assert max(deviation for _, deviation in errors[10:]) < sd_m, sensor
        assert all(error_m < 3.5 * deviation for error_m, deviation in errors), sensor
        account = estimator.account
        gated = account[f"{sensor}.gate"] / (account[f"{sensor}.gate"] + account[f"{sensor}.used"])
        assert 0.04 < gated < 0.25, sensor  # a tenth of ranges, of coordinates, of beams is wild
        assert account[f"{sensor}.late_applied"] > 20


@pytest.mark.parametrize("fitted", [True, False])
def test_a_message_of_a_sensor_that_is_not_fitted_is_counted_and_changes_nothing(fitted):
    suite = SENSORS if fitted else REALISTIC
    belief = Belief.blank(Layout.of(suite, CONFIG), 0)
    belief.P += 1e-2 * np.eye(len(belief.P))
    filter_ = ErrorStateFilter(suite, CONFIG, belief)
    before = belief.copy()
    filter_.correct(LblRange(t_ns=0, transponder=3, travel_time_s=0.1))
    if not fitted:
        filter_.correct(UsblFix(t_ns=0, north_m=0.1, east_m=0.1))
        filter_.correct(BottomTrack(t_ns=0, range_m=np.ones(4), beam_velocity_mps=np.zeros(4)))
    np.testing.assert_array_equal(belief.x, before.x)
    np.testing.assert_array_equal(belief.P, before.P)
    absent = {"lbl.not_fitted": 1, "usbl.not_fitted": 2, "bottom_track.not_fitted": 4}
    assert filter_.account == ({"lbl.unknown_transponder": 1} if fitted else absent)


SQUARED = 11.83
"""3 sigma in two dimensions: 99.73 % of chi-square with two degrees of freedom."""


def test_ranges_to_one_transponder_leave_the_uncertainty_of_its_curvature():
    """Thirty ranges share one error, which does not average out. Across the line of sight the drift remains.

    Each seed draws where the vehicle is after a drift of 30 m in each axis, and the ranges that it hears.
    """
    place, drift_m, seeds = (100.0, 0.0, 40.0), 30.0, 100
    net = {"transponders_m": (place,), "sound_speed_sd_mps": 0.0, "range_sd_m": 1.0, "lever_arm_m": (0.0, 0.0, 0.0)}
    suite = with_settings(replace(PAPER, lbl=LBL), lbl=net)
    nees, deviation = np.empty(seeds), 0.0
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        belief = Belief.blank(Layout.of(suite, CONFIG), 0)
        belief.P += 1e-6 * np.eye(len(belief.P))
        belief.P[:3, :3] = np.diag([drift_m**2, drift_m**2, 1e-4])
        belief.x[2] = 40.0
        truth = belief.x[:3] + np.array([drift_m, drift_m, 0.01]) * rng.standard_normal(3)
        filter_ = ErrorStateFilter(suite, CONFIG, belief)
        for _ in range(30):
            r = math.dist(truth, place) + rng.standard_normal()
            filter_.correct(LblRange(t_ns=0, transponder=0, travel_time_s=2 * r / 1500.0))
        error = (truth - belief.x[:3])[:2]
        nees[seed] = error @ np.linalg.solve(belief.P[:2, :2], error)
        deviation += math.sqrt(np.trace(belief.P[:2, :2])) / seeds
    assert 0.5 < np.mean(nees) / 2 < 1.3
    assert np.mean(nees < SQUARED) >= 0.95
    assert 29.0 < deviation < 34.0
