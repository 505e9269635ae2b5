"""Adaptive process noise: inflation when the current departs from its prior, and only then."""

import math
from functools import cache, partial
from typing import NamedTuple

import numpy as np
import pytest
from msgspec.structs import replace

from ltv_mpc.localisation.adaptive.glr_detector import OnsetDetection
from ltv_mpc.localisation.adaptive.process_noise import BACK_NS, AdaptiveProcessNoise, NoiseLevel
from ltv_mpc.localisation.filter.error_state_filter import ErrorStateFilter
from ltv_mpc.localisation.filter.state import ATTITUDE, GYRO_BIAS, VELOCITY, Belief, Layout
from ltv_mpc.localisation.sensors.adcp import beam_directions
from ltv_mpc.messages import ImuSample
from tests.ltv_mpc.localisation.dives import CONFIG, PAPER, Run, dive, with_water

BLIND = replace(CONFIG, adapts_to_water=False)
SECOND = 1_000_000_000
END_S, CALM_S = 45.0, 12.0
NONE, SLOW, FAST, AND_IMU = NoiseLevel.NONE, NoiseLevel.SLOW, NoiseLevel.FAST, NoiseLevel.FAST_AND_IMU


def ramp(size_mps, from_s, duration_s):
    """Return a current that increases to the north-east at all depths."""
    return lambda t_s, depth_m: size_mps * np.clip((t_s - from_s) / duration_s, 0.0, 1.0) * np.sqrt(0.5) + 0.0 * depth_m


FRONT = ramp(0.14, 20.0, 10.0)


def waves(t_s, depth_m):
    """Return the first mode of a column of 40 m: 5 cm/s, period 200 s."""
    return 0.05 * np.sin(2 * np.pi * t_s / 200.0) * np.cos(np.pi * depth_m / 40.0)


def filter_after(run):
    filter_ = run.estimator.filter
    filter_.propagate_covariance()
    return filter_


def run(messages, config=CONFIG):
    """Return the filter after the messages."""
    return filter_after(Run(messages, PAPER, config))


@cache
def calm(seed, duration_s):
    """Return the run of the first 12 s of a dive, in which no sensor is wrong and the water follows its prior."""
    return Run((m for m in dive(PAPER, seed, duration_s=duration_s).messages if m.t_ns <= CALM_S * SECOND), PAPER)


def after_calm(messages, seed=40, duration_s=END_S):
    """Return the filter after the messages, of which the first 12 s are those of the dive."""
    return filter_after(calm(seed, duration_s).continued(m for m in messages if m.t_ns > CALM_S * SECOND))


class Inflation(NamedTuple):
    level: NoiseLevel
    at_ns: int
    from_ns: int
    until_ns: int


@pytest.fixture
def inflations(monkeypatch):
    """Record the inflations of a filter."""
    log, back_ns = [], []
    inflate, restore = AdaptiveProcessNoise.inflate, ErrorStateFilter.restore

    def spy_restore(self, then):
        back_ns.append(then.belief.t_ns)
        return restore(self, then)

    def spy_inflate(self, level, until_ns, now_ns):
        log.append(Inflation(level, now_ns, back_ns[-1] if back_ns else now_ns, until_ns))
        return inflate(self, level, until_ns, now_ns)

    monkeypatch.setattr(ErrorStateFilter, "restore", spy_restore)
    monkeypatch.setattr(AdaptiveProcessNoise, "inflate", spy_inflate)
    return log


def off_by(filter_, of):
    """Return the NEES of the horizontal velocity: chi-square with 2 degrees of freedom."""
    e = filter_.belief.x[3:5] - of.velocity[-1, :2]
    return e @ np.linalg.solve(filter_.belief.P[3:5, 3:5], e)


def same(one, other):
    return np.array_equal(one.belief.x, other.belief.x) and np.array_equal(one.belief.P, other.belief.P)


the_dive = partial(dive, PAPER, 40, duration_s=END_S)
"""The dive of this file: made once, and not where only its tests are collected."""


def test_water_that_follows_its_prior_gives_bitwise_the_same_estimate(inflations):
    messages = [m for m in the_dive().messages if m.t_ns <= 30 * SECOND]
    adapting = after_calm(messages)
    assert inflations == []
    assert same(adapting, run(messages, BLIND))


def test_a_front_is_detected_within_seconds_and_velocity_is_then_consistent(inflations):
    """95 % of chi-square of 2 degrees is 6; a filter that does not adapt is off by hundreds."""
    filter_ = after_calm(with_water(the_dive(), FRONT))
    assert inflations[0].level is FAST
    assert 20 * SECOND < inflations[0].at_ns < 26 * SECOND
    assert off_by(filter_, the_dive()) < 6.0


def test_inflation_lasts_as_long_as_the_current_drifts(inflations):
    """0.24 m/s in 16 s: detected in its first seconds, and inflated for longer than the 10 s of a short front."""
    filter_ = after_calm(with_water(the_dive(), ramp(0.24, 20.0, 16.0)))
    assert [one.level for one in inflations] == [FAST]
    held_ns = inflations[0].until_ns
    assert held_ns < 35 * SECOND  # ten seconds would have ended before it
    assert filter_.process_noise.level(held_ns + 2 * SECOND) is FAST
    assert filter_.process_noise.level(41 * SECOND) is NONE
    assert off_by(filter_, the_dive()) < 9.2


def test_a_front_that_no_mean_shows_is_compensated(inflations, monkeypatch):
    """It started before the filter's buffer. The 99 % quantile of chi-square with 2 degrees of freedom is 9.2."""
    times_s, compensate = [], OnsetDetection.compensate
    monkeypatch.setattr(OnsetDetection, "compensate", lambda *a: (times_s.append(a[1].t_ns * 1e-9), compensate(*a)))
    of = dive(PAPER, 41, duration_s=60.0)
    assert off_by(after_calm(with_water(of, ramp(0.08, 20.0, 12.0)), 41, 60.0), of) < 9.2
    assert len(times_s) == 1
    assert inflations[-1].level is FAST


def test_waves_are_detected_and_the_currents_are_then_consistent(inflations):
    """Without inflation the square is twice as large."""
    belief, nodes = run(with_water(the_dive(), waves)).belief, np.arange(14, 30)  # those that are still seen
    k = belief.layout.north.start + nodes - belief.column.first
    e = belief.x[k] - the_dive().water[nodes, 0] - waves(END_S, nodes)
    assert SLOW in {one.level for one in inflations}
    assert e @ np.linalg.solve(belief.P[np.ix_(k, k)], e) / len(nodes) < 2.5


def test_a_step_between_two_cells_is_noticed(inflations):
    of = dive(PAPER, 42, duration_s=END_S)
    run(with_water(of, lambda _, depth_m: 0.3 * np.clip(depth_m - 24.5, 0.0, 1.0)))
    assert SLOW in {one.level for one in inflations}


def test_a_gyro_that_fails_is_not_taken_for_a_front_again_and_again(inflations):
    """30 deg/h, thirty times the specified bias: the filter learns it and stays consistent."""
    fault, messages = math.radians(30.0) / 3600.0, []
    for message in the_dive().messages:
        if isinstance(message, ImuSample) and message.t_ns > 12 * SECOND:
            p, q, r = message.angular_rate_radps
            message = replace(message, angular_rate_radps=(p + fault, q, r))
        messages.append(message)
    filter_ = after_calm(messages)
    assert [one.level for one in inflations] == [FAST, AND_IMU]
    assert off_by(filter_, the_dive()) < 9.2  # 99 % of chi-square of 2 degrees; of FAST alone, some eighty
    sd = np.sqrt(filter_.belief.P[GYRO_BIAS.start, GYRO_BIAS.start])
    assert abs(filter_.belief.x[GYRO_BIAS.start] - fault) < 3 * sd < 3 * fault


def test_inflation_applies_from_ten_seconds_before_its_detection(inflations):
    """Reference: a filter that is inflated at that instant and never goes back."""
    messages = with_water(the_dive(), FRONT)
    adapted = after_calm([m for m in messages if m.t_ns <= 26 * SECOND])
    assert len(inflations) == 1
    _, at_ns, from_ns, until_ns = inflations.pop()
    assert at_ns - BACK_NS - SECOND < from_ns <= at_ns - BACK_NS
    told = calm(40, END_S).continued(m for m in messages if CALM_S * SECOND < m.t_ns <= from_ns)
    filter_after(told).process_noise.inflate(FAST, until_ns, at_ns)
    told.feed(m for m in messages if from_ns < m.t_ns <= 26 * SECOND)
    assert same(adapted, filter_after(told))


def test_a_second_inflation_that_goes_back_beyond_the_first_keeps_it(monkeypatch):
    calls = {60: SLOW, 61: FAST}
    monkeypatch.setattr(
        AdaptiveProcessNoise, "required_level", lambda _, t_ns, _began: calls.pop(t_ns // 333_333_333, NONE)
    )
    water = after_calm([m for m in the_dive().messages if m.t_ns <= 35 * SECOND]).process_noise
    assert calls == {}
    assert water.level(35 * SECOND) is SLOW


def test_inflation_ends_and_lasts_longer_the_next_time():
    water = AdaptiveProcessNoise(1.0, 0)
    assert water.inflation_end_ns(FAST, 50 * SECOND) == 60 * SECOND
    water.inflate(FAST, 60 * SECOND, 50 * SECOND)
    assert water.level(60 * SECOND - 1) is FAST
    assert water.level(60 * SECOND) is NONE
    assert water.walk_mps_per_rts(60 * SECOND) == 0.0
    assert water.inflation_end_ns(FAST, 65 * SECOND) == 85 * SECOND
    assert water.inflation_end_ns(FAST, 90 * SECOND) == 100 * SECOND


U = np.repeat(beam_directions(PAPER.adcp.beam_angle_rad), 10, axis=0)
CELL = np.tile(np.arange(10), 4)
S = 1e-4 * np.eye(40)
QUICK = U @ [0.02, -0.01, 0.0]


def required(water, rng, pings, r, first=0):
    """Return the level that the last ping requires, after pings of white noise about ``r``."""
    for k in range(first, first + pings):
        water.add_innovations(k * SECOND // 3, U, CELL, r + 0.01 * rng.standard_normal(40), S)
    return water.required_level((first + pings - 1) * SECOND // 3)


@pytest.mark.parametrize(
    ("r", "level", "inconsistent"),
    [
        (0.0 * CELL, NONE, False),
        (QUICK, FAST, False),
        (U @ [0.007, 0.0, 0.0], AND_IMU, False),  # significant over ten seconds alone: it may be the IMU
        ((CELL - 4.5) * (U @ [0.003, 0.0, 0.0]), SLOW, False),
        (U @ [0.0, 0.0, 0.01], NONE, True),
        (U @ [0.02, -0.01, 0.01], NONE, True),
        # outliers of one sign along two opposite beams: as a velocity they would be 15 cm/s
        (np.where((CELL == 3) & (np.arange(40) < 20), np.sign(U[:, 0]) * 0.5, 0.0), NONE, False),
    ],
    ids=["noise", "velocity", "a velocity of one ping's deviation", "shear", "upward", "both", "outliers"],
)
def test_a_velocity_needs_fast_a_shear_slow_and_a_vertical_current_nothing(r, level, inconsistent):
    """A vertical current is caused by the IMU or the ADCP and is reported as inconsistent."""
    water = AdaptiveProcessNoise(1.0, 0)
    assert required(water, np.random.default_rng(3), 40, r) is level
    assert water.is_inconsistent(13 * SECOND) is inconsistent


@pytest.mark.parametrize("level", [FAST, AND_IMU])
def test_a_level_in_force_is_not_repeated_and_more_is_inconsistent(level):
    water, rng = AdaptiveProcessNoise(1.0, 0), np.random.default_rng(4)
    assert required(water, rng, 40, QUICK) is FAST
    assert not water.is_inconsistent(13 * SECOND)
    water.inflate(level, 30 * SECOND, 13 * SECOND)
    assert required(water, rng, 1, QUICK, first=40) is NONE
    assert water.is_inconsistent(14 * SECOND)
    assert not water.is_inconsistent(16 * SECOND)


@pytest.mark.parametrize(("again_s", "level"), [(15, AND_IMU), (19.5, AND_IMU), (21, FAST)])
def test_a_change_soon_after_a_front_may_be_the_imu_and_later_a_front(again_s, level):
    water = AdaptiveProcessNoise(1.0, 0)
    water.inflate(FAST, 10 * SECOND, 0)
    r, first = U @ [0.04, -0.01, 0.0], round(3 * again_s)
    assert required(water, np.random.default_rng(11), 1, 0.0 * CELL, first=first - 1) is NONE
    assert required(water, np.random.default_rng(12), 2, r, first=first) is level


def test_a_reinitialised_filter_detects_no_front_at_first():
    for from_s, level in ((20, NONE), (13, FAST)):
        assert required(AdaptiveProcessNoise(1.0, from_s * SECOND), np.random.default_rng(5), 40, QUICK) is level


def test_beams_of_one_plane_alone_are_not_fitted():
    water, two = AdaptiveProcessNoise(1.0, 0), slice(0, 20)
    for k in range(40):
        water.add_innovations(k * SECOND // 3, U[two], CELL[two], np.full(20, 0.1), S[two, two])
    assert water.required_level(13 * SECOND) is NONE


def inflated(level, seconds):
    """Return the layout of a belief, and what the inflated noise adds to its covariance in each time (s)."""
    belief = Belief.blank(Layout.of(PAPER, replace(CONFIG, deepest_m=19.0)), 0)
    belief.P = 1e-4 * np.eye(belief.layout.size)
    water, added = AdaptiveProcessNoise(1.0, 0), []
    water.inflate(level, 20 * SECOND, 0)
    for dt in seconds:
        before = belief.P.copy()
        water.propagate(belief, dt)
        added.append(belief.P - before)
    np.testing.assert_array_equal(belief.P, belief.P.T)
    assert np.linalg.eigvalsh(belief.P)[0] > 0
    return belief.layout, *added


def test_inflation_of_all_depths_is_smooth():
    layout, grown = inflated(FAST, [4.0])
    z = np.arange(20)
    for axis in (layout.north, layout.east):
        np.testing.assert_allclose(grown[axis, axis], 4.0 * 0.05**2 * np.exp(-np.abs(z[:, None] - z) / 30.0))
        grown[axis, axis] = 0.0
    assert not grown.any()
    assert not inflated(NONE, [4.0])[1].any()


def test_imu_states_are_inflated_once_velocity_and_water_together():
    layout, first, walk = inflated(AND_IMU, [1.0, 1.0])
    once = first - walk
    np.testing.assert_allclose(np.diag(once[GYRO_BIAS, GYRO_BIAS]), (5e-4) ** 2)
    np.testing.assert_allclose(np.diag(once[ATTITUDE, ATTITUDE]), [1e-4, 1e-4, 0.0], atol=1e-18)
    for axis, nodes in enumerate((layout.north, layout.east)):
        alike = [VELOCITY.start + axis, layout.mean.start + axis, *range(nodes.start, nodes.stop)]
        np.testing.assert_allclose(once[np.ix_(alike, alike)], 0.09)
    assert once[VELOCITY.start, VELOCITY.start + 1] == once[VELOCITY.start + 2, VELOCITY.start + 2] == 0.0
