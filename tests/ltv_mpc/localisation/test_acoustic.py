"""Ranges, fixes and bottom track bound the drift of dead reckoning; the first fix after a long drift is consistent."""

import math

import numpy as np
import pytest
from msgspec.structs import replace

from ltv_mpc.localisation.filter.error_state_filter import ErrorStateFilter
from ltv_mpc.localisation.filter.state import Belief, Layout
from ltv_mpc.localisation.sensors.adcp import beam_directions
from ltv_mpc.messages import AdcpPing, BottomTrack, LblRange, UsblFix
from tests.ltv_mpc.localisation.dives import CONFIG as SHIPPED
from tests.ltv_mpc.localisation.dives import PAPER, REALISTIC, Run, S, dive, error_of
from tests.ltv_mpc.localisation.sensors.every_sensor import EVERY_SENSOR, with_settings

ODD = {"missing_share": 0.1, "outlier_share": 0.1}
LBL = replace(
    EVERY_SENSOR.lbl,
    **ODD,
    period_ns=5 * S,
    transponders_m=((150.0, 0.0, 60.0), (-75.0, 130.0, 60.0), (-75.0, -130.0, 60.0)),
    sound_speed_sd_mps=5.0,
    range_sd_m=0.5,
    outlier_m=20.0,
    lever_arm_m=(0.8, 0.0, -0.4),
)
USBL = replace(
    EVERY_SENSOR.usbl,
    **ODD,
    period_ns=2 * S,
    latency_ns=800_000_000,
    ship_m=(60.0, -40.0),
    bearing_sd_rad=0.01,
    outlier_m=20.0,
    lever_arm_m=(-0.5, 0.2, -0.4),
)
TRACKING = replace(
    EVERY_SENSOR.bottom_track, **ODD, period_ns=S // 2, range_m=50.0, beam_noise_sd_mps=0.003, latency_ns=S // 10
)
SENSORS = replace(REALISTIC, lbl=LBL, usbl=USBL, bottom_track=TRACKING)
CONFIG = replace(SHIPPED, deepest_m=5.0)
DIVE = dive(SENSORS, 11, duration_s=60.0)


def at(t_ns, lever):
    """Return position and velocity of a point of the vehicle at an inertial sample, by differences of the truth."""
    k = DIVE.at(t_ns)
    path = DIVE.position[k - 1 : k + 2] + DIVE.R[k - 1 : k + 2] @ np.array(lever)
    return path[1], (path[2] - path[0]) / 0.02


def ranges(rng):
    c = 1500.0 + 5.0 * rng.standard_normal()
    for t_ns in range(5 * S, 60 * S, 5 * S):
        for j, place in enumerate(LBL.transponders_m):
            r = math.dist(at(t_ns, LBL.lever_arm_m)[0], place)
            noise = 0.5 * rng.standard_normal() + 20.0 * (rng.uniform() < 0.1)
            travel_time_s = 2 * r / c + 2 * noise / 1500.0
            yield t_ns + round(0.5e9 * travel_time_s), LblRange(t_ns=t_ns, transponder=j, travel_time_s=travel_time_s)


def fixes(rng):
    for t_ns in range(2 * S, 59 * S, 2 * S):
        p, _ = at(t_ns, USBL.lever_arm_m)
        sd = math.hypot(1.0, 0.01 * math.dist(p, (*USBL.ship_m, 0.0)))
        n, e = p[:2] + sd * rng.standard_normal(2) + 20.0 * rng.choice([-1, 1], 2) * (rng.uniform(size=2) < 0.1)
        yield t_ns + 800_000_000, UsblFix(t_ns=t_ns, north_m=float(n), east_m=float(e))


def bottom(rng):
    for t_ns in range(S, 60 * S, 500_000_000):
        _, v = at(t_ns, SENSORS.adcp.lever_arm_m)
        z = -(beam_directions(SENSORS.adcp.beam_angle_rad) @ DIVE.R[DIVE.at(t_ns)].T) @ v + 0.003 * rng.standard_normal(
            4
        )
        z += 0.5 * rng.choice([-1, 1], 4) * (rng.uniform(size=4) < 0.1)
        z[rng.uniform(size=4) < 0.1] = np.nan
        yield t_ns + 100_000_000, BottomTrack(t_ns=t_ns, range_m=0 * z + 30.0, beam_velocity_mps=z)


def drifts(aid=None):
    """Return horizontal error (m) and its deviation for each second, without the profiler, and the estimator."""
    arriving = [(m.t_ns, i, m) for i, m in enumerate(DIVE.messages) if not isinstance(m, AdcpPing)]
    if aid is not None:
        arriving += [(t_ns, 10**6 + i, m) for i, (t_ns, m) in enumerate(aid(np.random.default_rng(3)))]
    run = Run((m for _, _, m in sorted(arriving, key=lambda entry: entry[:2])), SENSORS, CONFIG)
    seconds = [estimate for t_ns, estimate in run.estimates.items() if t_ns > 0 and t_ns % S == 0]
    assert all((e.altitude_m is None) == (aid is not bottom or e.t_ns <= S) for e in seconds)
    errors = [(math.hypot(*error_of(e, DIVE)[:2]), math.sqrt(np.trace(e.covariance[:2, :2]))) for e in seconds]
    return errors, run.estimator


def test_each_sensor_bounds_the_drift_of_dead_reckoning():
    """Dead reckoning is lost after 60 s; ranges and fixes bound the position, bottom track the velocity."""
    alone, _ = drifts()
    assert alone[-1][1] > 12.0
    # sensor, what it brings, deviation at the end: the sea bed does not mend the 5 m that the satellites left
    for sensor, aid, sd_m in (("lbl", ranges, 1.5), ("usbl", fixes, 1.5), ("bottom_track", bottom, 5.2)):
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


def first_fixes(transponders, drift_m, *, calls, seeds=100):
    """After a drift of ``drift_m`` (1 sd, each axis): error over deviation, squared, and rejected ranges, by seed.

    Each seed draws where the vehicle really is, and the ranges that it hears.
    """
    net = {"transponders_m": transponders, "sound_speed_sd_mps": 0.0, "range_sd_m": 1.0, "lever_arm_m": (0.0, 0.0, 0.0)}
    suite = with_settings(replace(PAPER, lbl=LBL), lbl=net)
    nees, gated, deviation = np.empty(seeds), 0, 0.0
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        belief = Belief.blank(Layout.of(suite, CONFIG), 0)
        belief.P += 1e-6 * np.eye(len(belief.P))
        belief.P[:3, :3] = np.diag([drift_m**2, drift_m**2, 1e-4])
        belief.x[2] = 40.0
        truth = belief.x[:3] + np.array([drift_m, drift_m, 0.01]) * rng.standard_normal(3)
        filter_ = ErrorStateFilter(suite, CONFIG, belief)
        for _ in range(calls):
            for j, place in enumerate(transponders):
                r = math.dist(truth, place) + rng.standard_normal()
                filter_.correct(LblRange(t_ns=0, transponder=j, travel_time_s=2 * r / 1500.0))
        error = (truth - belief.x[:3])[:2]
        nees[seed] = error @ np.linalg.solve(belief.P[:2, :2], error)
        gated += filter_.account["lbl.gate"]
        deviation += math.sqrt(np.trace(belief.P[:2, :2])) / seeds
    return nees, gated / (seeds * calls * len(transponders)), deviation


FOUR = ((100.0, 0.0, 40.0), (0.0, 100.0, 40.0), (-100.0, 0.0, 40.0), (0.0, -100.0, 40.0))
SQUARED = 11.83
"""3 sigma in two dimensions: 99.73 % of chi-square with two degrees of freedom."""


def test_the_first_range_after_a_long_drift_leaves_an_error_within_three_sigma():
    """Transponders 100 m away. Without the second-order term a third of the vehicles would be outside."""
    nees, gated, deviation = first_fixes(FOUR, 30.0, calls=1)
    assert np.mean(nees < SQUARED) >= 0.98
    assert gated < 0.01
    assert deviation < 2.0
    nees, gated, deviation = first_fixes(FOUR, 10.0, calls=3)
    assert np.mean(nees) / 2 == pytest.approx(1.0, abs=0.3)
    assert gated < 0.005
    assert deviation < 0.65


def test_ranges_to_one_transponder_leave_the_uncertainty_of_its_curvature():
    """Thirty ranges share one error, which does not average out. Across the line of sight the drift remains."""
    nees, _, deviation = first_fixes(FOUR[:1], 30.0, calls=30)
    assert 0.5 < np.mean(nees) / 2 < 1.3
    assert np.mean(nees < SQUARED) >= 0.95
    assert 29.0 < deviation < 34.0
