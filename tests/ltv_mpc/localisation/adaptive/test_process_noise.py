"""Adaptive process noise: inflation when the current departs from its prior, and only then."""

import math
from typing import NamedTuple

import msgspec
import numpy as np
import pytest

from ltv_mpc.localisation.adaptive.glr_detector import OnsetDetection
from ltv_mpc.localisation.adaptive.process_noise import BACK_NS, AdaptiveProcessNoise, NoiseLevel
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.estimator import Estimator
from ltv_mpc.localisation.filter.error_state_filter import ErrorStateFilter
from ltv_mpc.localisation.filter.state import ATTITUDE, GYRO_BIAS, VELOCITY, Belief, Layout
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.sensors.adcp import beam_directions
from ltv_mpc.messages import AdcpPing, ImuSample
from tests.stepping import feed

PAPER = SensorConfig.load("paper")
CONFIG = EstimatorConfig()
BLIND = msgspec.structs.replace(CONFIG, adapts_to_water=False)
SECOND = 1_000_000_000
END_S = 45.0
CELLS = 20


def ramp(size_mps, from_s, duration_s):
    """Return a current that increases to the north-east at all depths."""
    return lambda t_s, depth_m: size_mps * np.clip((t_s - from_s) / duration_s, 0.0, 1.0) * np.sqrt(0.5) + 0.0 * depth_m


front = ramp(0.14, 20.0, 10.0)


def waves(t_s, depth_m):
    """Return the first mode of a column of 40 m: 5 cm/s, period 200 s."""
    return 0.05 * np.sin(2 * np.pi * t_s / 200.0) * np.cos(np.pi * depth_m / 40.0)


def with_water(dive, extra):
    """Return the dive's messages as if the water moved by ``extra`` more, north and east alike (nominal mounting)."""
    beams = beam_directions(PAPER.adcp.beam_angle_rad)
    out = []
    for message in dive.messages:
        if isinstance(message, AdcpPing):
            k = dive.at(message.t_ns)
            u = beams @ dive.R[k].T
            depth = dive.position[k, 2] + np.outer(u[:, 2], message.range_m)
            more = (u[:, :1] + u[:, 1:2]) * extra(message.t_ns * 1e-9, depth)
            message = msgspec.structs.replace(message, beam_velocity_mps=message.beam_velocity_mps + more)
        out.append(message)
    return out


@pytest.fixture(scope="module")
def dives(make_dive):
    return [make_dive(PAPER, seed, duration_s=END_S) for seed in (40, 41)]


@pytest.fixture(scope="module")
def run(inbox_of):
    def run(messages, config=CONFIG, estimator=None):
        estimator = estimator or Estimator(PAPER, config)
        feed(estimator, [(message.t_ns, inbox_of(message)) for message in messages])
        estimator.filter.propagate_covariance()
        return estimator.filter

    return run


class Granted(NamedTuple):
    change: NoiseLevel
    at_ns: int
    from_ns: int
    until_ns: int


@pytest.fixture
def granted(monkeypatch):
    """Record the inflations of a filter."""
    log = []
    grant, restore = AdaptiveProcessNoise.inflate, ErrorStateFilter.restore
    back_ns = []

    def spy_restore(self, then):
        back_ns.append(then.belief.t_ns)
        return restore(self, then)

    def spy_grant(self, change, until_ns, now_ns):
        log.append(Granted(change, now_ns, back_ns[-1] if back_ns else now_ns, until_ns))
        return grant(self, change, until_ns, now_ns)

    monkeypatch.setattr(ErrorStateFilter, "restore", spy_restore)
    monkeypatch.setattr(AdaptiveProcessNoise, "inflate", spy_grant)
    return log


def off_by(filter_, dive):
    """Return the NEES of the horizontal velocity: chi-square with 2 degrees of freedom."""
    e = filter_.belief.x[3:5] - dive.velocity[-1, :2]
    return e @ np.linalg.solve(filter_.belief.P[3:5, 3:5], e)


def same(one, other):
    return np.array_equal(one.belief.x, other.belief.x) and np.array_equal(one.belief.P, other.belief.P)


def test_water_that_follows_its_prior_gives_bitwise_the_same_estimate(dives, run, granted):
    filters = [run(dive.messages) for dive in dives]
    assert granted == []
    assert same(filters[0], run(dives[0].messages, BLIND))


def test_a_front_is_detected_within_seconds_and_velocity_is_then_consistent(dives, run, granted):
    """95 % of chi-square of twice 2 degrees is 9.5; a filter that does not adapt is off by hundreds."""
    off = 0.0
    for dive in dives:
        granted.clear()
        messages = with_water(dive, front)
        off += off_by(run(messages), dive)
        assert granted[0].change is NoiseLevel.FAST
        assert 20 * SECOND < granted[0].at_ns < 26 * SECOND
    assert off < 9.5
    assert off_by(run(messages, BLIND), dive) > 100


@pytest.fixture
def made_up(monkeypatch):
    """Record the times of compensations (s)."""
    log, compensate = [], OnsetDetection.compensate
    monkeypatch.setattr(
        OnsetDetection, "compensate", lambda found, belief: (log.append(belief.t_ns * 1e-9), compensate(found, belief))
    )
    return log


def test_inflation_lasts_as_long_as_the_current_drifts(make_dive, run, granted):
    """0.24 m/s in 16 s: detected in its first seconds, and inflated for longer than the 10 s of a short front."""
    dive = make_dive(PAPER, 40, duration_s=END_S)
    messages = with_water(dive, ramp(0.24, 20.0, 16.0))
    filter_ = run(messages)
    assert [one.change for one in granted] == [NoiseLevel.FAST]
    held_ns = granted[0].until_ns
    assert held_ns < 35 * SECOND  # ten seconds would have ended before it
    assert filter_.process_noise.level(held_ns + 2 * SECOND) is NoiseLevel.FAST
    assert filter_.process_noise.level(41 * SECOND) is NoiseLevel.NONE
    assert off_by(filter_, dive) < 9.2


@pytest.mark.parametrize(("size", "duration_s", "seeds"), [(0.08, 12.0, (41, 42)), (0.2, 25.0, (40, 43))])
def test_a_front_that_no_mean_shows_is_compensated(make_dive, run, granted, made_up, size, duration_s, seeds):
    """It started before the filter's buffer. The 99 % quantile of chi-square with 4 degrees of freedom is 13.3."""
    off = 0.0
    for seed in seeds:
        made_up.clear()
        dive = make_dive(PAPER, seed, duration_s=60.0)
        messages = with_water(dive, ramp(size, 20.0 if duration_s < 20 else 15.0, duration_s))
        off += off_by(run(messages), dive)
        assert len(made_up) == 1
        assert granted[-1].change is NoiseLevel.FAST
    assert off < 13.3
    assert off_by(run(messages, BLIND), dive) > 100


def test_waves_are_detected_and_the_currents_are_then_consistent(dives, run, granted):
    dive = dives[0]
    messages = with_water(dive, waves)
    square = {}
    for config in (CONFIG, BLIND):
        belief = run(messages, config).belief
        nodes = np.arange(14, 30)  # those that are still seen
        truth = dive.water[nodes, 0] + waves(END_S, nodes)
        k = belief.layout.north.start + nodes - belief.column.first
        e = belief.x[k] - truth
        square[config.adapts_to_water] = e @ np.linalg.solve(belief.P[np.ix_(k, k)], e) / len(nodes)
    assert NoiseLevel.SLOW in {one.change for one in granted}
    assert square[False] > 5
    assert square[True] < 2.5


def test_a_gyro_that_fails_is_not_taken_for_a_front_again_and_again(dives, run, granted):
    """30 deg/h, thirty times the specified bias: the filter learns it and stays consistent."""
    dive, fault = dives[0], math.radians(30.0) / 3600.0
    messages = []
    for message in dive.messages:
        if isinstance(message, ImuSample) and message.t_ns > 12 * SECOND:
            p, q, r = message.angular_rate_radps
            message = msgspec.structs.replace(message, angular_rate_radps=(p + fault, q, r))
        messages.append(message)
    filter_ = run(messages)
    assert [one.change for one in granted] == [NoiseLevel.FAST, NoiseLevel.FAST_AND_IMU]
    assert off_by(filter_, dive) < 9.2  # 99 % of chi-square of 2 degrees; of FAST alone, some eighty
    sd = np.sqrt(filter_.belief.P[GYRO_BIAS.start, GYRO_BIAS.start])
    assert abs(filter_.belief.x[GYRO_BIAS.start] - fault) < 3 * sd < 3 * fault


def test_inflation_applies_from_ten_seconds_before_its_detection(dives, run, granted):
    """Reference: a filter that is inflated at that instant and never goes back."""
    dive = dives[0]
    messages = with_water(dive, front)
    adapted = run([m for m in messages if m.t_ns <= 26 * SECOND])
    assert len(granted) == 1
    _, at_ns, from_ns, until_ns = granted.pop()
    assert at_ns - BACK_NS - SECOND < from_ns <= at_ns - BACK_NS

    told = Estimator(PAPER, CONFIG)
    run([m for m in messages if m.t_ns <= from_ns], estimator=told)
    told.filter.process_noise.inflate(NoiseLevel.FAST, until_ns, at_ns)
    assert same(adapted, run([m for m in messages if from_ns < m.t_ns <= 26 * SECOND], estimator=told))


def test_a_second_inflation_that_goes_back_beyond_the_first_keeps_it(dives, run, monkeypatch):
    calls = {60: NoiseLevel.SLOW, 61: NoiseLevel.FAST}
    monkeypatch.setattr(
        AdaptiveProcessNoise, "required_level", lambda _, t_ns, _began: calls.pop(t_ns // 333_333_333, NoiseLevel.NONE)
    )
    water = run([m for m in dives[0].messages if m.t_ns <= 35 * SECOND]).process_noise
    assert calls == {}
    assert water.level(35 * SECOND) is NoiseLevel.SLOW


def test_inflation_ends_and_lasts_longer_the_next_time():
    water = AdaptiveProcessNoise(1.0, 0)
    assert water.inflation_end_ns(NoiseLevel.FAST, 50 * SECOND) == 60 * SECOND
    water.inflate(NoiseLevel.FAST, 60 * SECOND, 50 * SECOND)
    assert water.level(60 * SECOND - 1) is NoiseLevel.FAST
    assert water.level(60 * SECOND) is NoiseLevel.NONE
    assert water.walk_mps_per_rts(60 * SECOND) == 0.0
    assert water.inflation_end_ns(NoiseLevel.FAST, 65 * SECOND) == 85 * SECOND
    assert water.inflation_end_ns(NoiseLevel.FAST, 90 * SECOND) == 100 * SECOND


U = np.repeat(beam_directions(PAPER.adcp.beam_angle_rad), 10, axis=0)
CELL = np.tile(np.arange(10), 4)
S = 1e-4 * np.eye(40)


def hear(water, rng, pings, r, first=0):
    """Return the level that the last ping requires, after pings of white noise about ``r``."""
    for k in range(first, first + pings):
        water.add_innovations(k * SECOND // 3, U, CELL, r + 0.01 * rng.standard_normal(40), S)
    return water.required_level((first + pings - 1) * SECOND // 3)


@pytest.mark.parametrize(
    ("r", "change", "beyond"),
    [
        (0.0 * CELL, NoiseLevel.NONE, False),
        (U @ [0.02, -0.01, 0.0], NoiseLevel.FAST, False),
        (U @ [0.007, 0.0, 0.0], NoiseLevel.FAST_AND_IMU, False),
        ((CELL - 4.5) * (U @ [0.003, 0.0, 0.0]), NoiseLevel.SLOW, False),
        (U @ [0.0, 0.0, 0.01], NoiseLevel.NONE, True),
        (U @ [0.02, -0.01, 0.01], NoiseLevel.NONE, True),
    ],
    ids=["noise", "velocity", "a velocity of one ping's deviation", "shear", "upward", "velocity and upward"],
)
def test_a_velocity_needs_fast_a_shear_slow_and_a_vertical_current_nothing(r, change, beyond):
    """A vertical current is caused by the IMU or the ADCP and is reported as inconsistent."""
    water = AdaptiveProcessNoise(1.0, 0)
    assert hear(water, np.random.default_rng(3), 40, r) is change
    assert water.is_inconsistent(13 * SECOND) is beyond


def test_outliers_on_every_tenth_row_inflate_nothing():
    """Outliers have one sign along two opposite beams: as a velocity they would be 15 cm/s."""
    water = AdaptiveProcessNoise(1.0, 0)
    r = np.where((CELL == 3) & (np.arange(40) < 20), np.sign(U[:, 0]) * 0.5, 0.0)
    assert hear(water, np.random.default_rng(8), 12, r) is NoiseLevel.NONE


@pytest.mark.parametrize("change", [NoiseLevel.FAST, NoiseLevel.FAST_AND_IMU])
def test_a_level_in_force_is_not_repeated_and_more_is_inconsistent(change):
    water = AdaptiveProcessNoise(1.0, 0)
    rng, r = np.random.default_rng(4), U @ [0.02, -0.01, 0.0]
    assert hear(water, rng, 40, r) is NoiseLevel.FAST
    assert not water.is_inconsistent(13 * SECOND)
    water.inflate(change, 30 * SECOND, 13 * SECOND)
    assert hear(water, rng, 1, r, first=40) is NoiseLevel.NONE
    assert water.is_inconsistent(14 * SECOND)
    assert not water.is_inconsistent(16 * SECOND)


def test_a_change_soon_after_a_front_may_be_the_imu_and_later_a_front():
    for again_s, change in ((15, NoiseLevel.FAST_AND_IMU), (19.5, NoiseLevel.FAST_AND_IMU), (21, NoiseLevel.FAST)):
        water = AdaptiveProcessNoise(1.0, 0)
        water.inflate(NoiseLevel.FAST, 10 * SECOND, 0)
        r, first = U @ [0.04, -0.01, 0.0], round(3 * again_s)
        assert hear(water, np.random.default_rng(11), 1, 0.0 * CELL, first=first - 1) is NoiseLevel.NONE
        assert hear(water, np.random.default_rng(12), 2, r, first=first) is change


def test_what_is_significant_over_ten_seconds_alone_may_be_the_imu():
    """0.3 standard deviations per ping are significant after 30 pings, not after 9 within 3 s."""
    water = AdaptiveProcessNoise(1.0, 0)
    calls = [hear(water, np.random.default_rng(k), 1, U @ [0.0038, 0.0, 0.0], first=k) for k in range(120)]
    assert next(call for call in calls if call is not NoiseLevel.NONE) is NoiseLevel.FAST_AND_IMU


def test_imu_states_are_inflated_once_velocity_and_water_together():
    belief = belief_of_water()
    water = AdaptiveProcessNoise(1.0, 0)
    water.inflate(NoiseLevel.FAST_AND_IMU, 20 * SECOND, 0)
    before = belief.P.copy()
    water.propagate(belief, 1.0)
    first = belief.P - before
    before = belief.P.copy()
    water.propagate(belief, 1.0)
    walk = belief.P - before

    opened, layout = first - walk, belief.layout
    for i in range(3):
        assert opened[GYRO_BIAS, GYRO_BIAS][i, i] == pytest.approx((5e-4) ** 2)
    for i in range(2):
        assert opened[ATTITUDE, ATTITUDE][i, i] == pytest.approx(1e-4)
    assert opened[ATTITUDE, ATTITUDE][2, 2] == 0.0
    for axis, nodes in enumerate((layout.north, layout.east)):
        v, m = VELOCITY.start + axis, layout.mean.start + axis
        alike = [v, m, *range(nodes.start, nodes.stop)]
        np.testing.assert_allclose(opened[np.ix_(alike, alike)], 0.09)
    assert opened[VELOCITY.start, VELOCITY.start + 1] == opened[VELOCITY.start + 2, VELOCITY.start + 2] == 0.0
    np.testing.assert_array_equal(belief.P, belief.P.T)
    assert np.linalg.eigvalsh(belief.P)[0] > 0


def test_a_reinitialised_filter_detects_no_front_at_first():
    rng, r = np.random.default_rng(5), U @ [0.02, -0.01, 0.0]
    assert hear(AdaptiveProcessNoise(1.0, 20 * SECOND), rng, 40, r) is NoiseLevel.NONE
    assert hear(AdaptiveProcessNoise(1.0, 13 * SECOND), rng, 40, r) is NoiseLevel.FAST


def test_beams_of_one_plane_alone_are_not_fitted():
    water = AdaptiveProcessNoise(1.0, 0)
    two = slice(0, 20)
    for k in range(40):
        water.add_innovations(k * SECOND // 3, U[two], CELL[two], np.full(20, 0.1), S[two, two])
    assert water.required_level(13 * SECOND) is NoiseLevel.NONE


def belief_of_water():
    config = msgspec.structs.replace(CONFIG, deepest_m=float(CELLS - 1))
    belief = Belief.blank(Layout.of(PAPER, config), 0)
    belief.P = 1e-4 * np.eye(belief.layout.size)
    return belief


def test_a_step_between_two_cells_is_noticed(dives, run, granted):
    def step(_, depth_m):
        return 0.3 * np.clip(depth_m - 24.5, 0.0, 1.0)

    run(with_water(dives[0], step))
    assert NoiseLevel.SLOW in {one.change for one in granted}


def test_inflation_of_all_depths_is_smooth_and_keeps_the_covariance_definite():
    belief = belief_of_water()
    water = AdaptiveProcessNoise(1.0, 0)
    before = belief.P.copy()
    water.propagate(belief, 4.0)
    np.testing.assert_array_equal(belief.P, before)
    water.inflate(NoiseLevel.FAST, SECOND, 0)
    water.propagate(belief, 4.0)
    grown, z = belief.P - before, np.arange(CELLS)
    expected = 4.0 * 0.05**2 * np.exp(-np.abs(z[:, None] - z) / 30.0)
    for axis in (belief.layout.north, belief.layout.east):
        np.testing.assert_allclose(grown[axis, axis], expected)
        grown[axis, axis] = 0.0
    assert not grown.any()
    np.testing.assert_array_equal(belief.P, belief.P.T)
    assert np.linalg.eigvalsh(belief.P)[0] > 0
