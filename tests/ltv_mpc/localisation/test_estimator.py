"""The estimator node: when it publishes, in which order it uses messages, and what an estimate contains."""

import msgspec
import numpy as np
import pytest

from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.estimator import Estimator
from ltv_mpc.localisation.filter.error_state_filter import ErrorStateFilter
from ltv_mpc.localisation.filter.state import Belief, Layout, grid
from ltv_mpc.localisation.publishing import estimate
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.sensors import BY_MESSAGE
from ltv_mpc.localisation.sensors.bottom_track import BottomTracking
from ltv_mpc.messages import AdcpPing, BottomTrack, CompassHeading, Estimate, GnssFix, ImuSample, PressureDepth, TdcpFix

SUITE = SensorConfig.load("realistic")
CONFIG = EstimatorConfig()
PERIOD_NS = CONFIG.estimate_period_ns


@pytest.fixture(scope="module")
def dive(make_dive):
    return make_dive(SUITE, 5, duration_s=4.0)


@pytest.fixture
def run(inbox_of):
    def run(messages, config=CONFIG, estimator=None, suite=SUITE):
        estimator = estimator or Estimator(suite, config)
        out = []
        for message in messages:
            said = estimator.step(message.t_ns, inbox_of(message))
            out += [(message, one) for one in said if isinstance(one, Estimate)]
        return estimator, out

    return run


def same(a: Estimate, b: Estimate) -> bool:
    return msgspec.to_builtins(a, enc_hook=lambda x: x.tolist()) == msgspec.to_builtins(
        b, enc_hook=lambda x: x.tolist()
    )


def test_it_publishes_once_a_period_from_alignment_on_and_at_zero(dive, run):
    _, out = run(dive.messages)
    times = [said.t_ns for _, said in out]
    assert times == list(range(times[0], 4_000_000_001, PERIOD_NS))
    assert times[0] == -900_000_000
    assert 0 in times


def test_until_it_is_aligned_it_publishes_nothing_and_names_what_it_waits_for(dive, run):
    without = [m for m in dive.messages if not isinstance(m, CompassHeading)]
    estimator, out = run(without)
    assert out == []
    assert estimator.waiting_for.startswith("compass")
    aligned, _ = run(dive.messages)
    assert aligned.waiting_for == ""


def test_an_estimate_comes_with_the_last_message_due_at_its_time(dive, run):
    _, out = run(dive.messages)
    causes = {said.t_ns: cause for cause, said in out if said.t_ns >= -700_000_000}
    assert isinstance(causes[0], CompassHeading)
    assert isinstance(causes[1_000_000_000], CompassHeading)
    assert isinstance(causes[1_100_000_000], PressureDepth)
    assert all(cause.t_ns == t_ns for t_ns, cause in causes.items())


def test_an_estimate_holds_everything_measured_at_its_time(dive, run):
    """The carrier phase at 0 brings the velocity from 2 cm/s to below 1: it must be in the estimate of 0."""
    _, out = run(dive.messages)
    at_zero = next(said for _, said in out if said.t_ns == 0)
    assert np.sqrt(at_zero.covariance[2, 2]) < 0.008
    before = next(said for _, said in out if said.t_ns == -PERIOD_NS)
    assert np.sqrt(before.covariance[2, 2]) > 0.012


def test_a_sensor_that_is_silent_does_not_hold_the_estimate_for_more_than_one_sample(dive, run):
    _, out = run([m for m in dive.messages if not (isinstance(m, PressureDepth) and m.t_ns > 0)])
    late = {said.t_ns: cause.t_ns - said.t_ns for cause, said in out if said.t_ns > 0}
    assert list(late) == list(range(PERIOD_NS, 4_000_000_000, PERIOD_NS))
    assert max(late.values()) <= 10_000_000


def test_an_estimate_waits_for_a_bottom_track_without_latency(dive, run):
    """Ten bottom tracks a second, each the last message of its instant."""
    tracking = BottomTracking(
        period_ns=PERIOD_NS, range_m=50.0, beam_noise_sd_mps=0.01, missing_share=0.0, outlier_share=0.0, outlier_mps=0.0
    )
    nothing = np.full(4, np.nan)
    pings = [BottomTrack(t_ns=k * PERIOD_NS, range_m=nothing, beam_velocity_mps=nothing) for k in range(-5, 41)]
    messages = sorted([*dive.messages, *pings], key=lambda m: (m.t_ns, isinstance(m, BottomTrack)))
    for latency_ns, last in ((0, BottomTrack), (20_000_000, PressureDepth)):
        slow = msgspec.structs.replace(tracking, latency_ns=latency_ns)
        _, out = run(messages, suite=msgspec.structs.replace(SUITE, bottom_track=slow))
        causes = {type(cause) for cause, said in out if said.t_ns > 0 and said.t_ns % 1_000_000_000}
        assert causes == {last}


@pytest.mark.parametrize("sensor", ["adcp", "pressure", "compass", "gnss", "tdcp"])
def test_an_estimate_does_not_wait_for_a_sensor_that_is_late_by_its_file(dive, run, sensor):
    """Nor for an absent one: at -0.1 s only the pressure is due, at 0 everything but the profiler's ping."""
    late = msgspec.structs.replace(getattr(SUITE, sensor), latency_ns=50_000_000)
    kind = next(kind for kind, s in BY_MESSAGE.items() if s.name == sensor)
    others = [m for m in dive.messages if not isinstance(m, kind) or m.t_ns < -800_000_000]
    _, out = run(others, suite=msgspec.structs.replace(SUITE, **{sensor: late}))
    delays = {said.t_ns: cause.t_ns - said.t_ns for cause, said in out}
    assert max(delays[t_ns] for t_ns in (-100_000_000, 0, 1_000_000_000)) == 0


def test_the_order_of_arrival_at_one_instant_and_within_one_sample_does_not_matter(dive, run):
    """Aiding messages that come ahead of the inertial sample that covers them wait for it.

    Only the points of linearisation differ: a few hundredths of the deviation.
    """
    order = {ImuSample: 9, CompassHeading: 0, PressureDepth: 1, AdcpPing: 2, TdcpFix: 3, GnssFix: 4}
    messages = [m for m in dive.messages if m.t_ns > -700_000_000]
    first = [m for m in dive.messages if m.t_ns <= -700_000_000]
    other = sorted(messages, key=lambda m: (-(-m.t_ns // 10_000_000), order[type(m)], m.t_ns))
    usual, swapped = run(first + messages)[1], run(first + other)[1]
    assert [said.t_ns for _, said in usual] == [said.t_ns for _, said in swapped]
    for (_, a), (_, b) in zip(usual, swapped, strict=True):
        assert a.north_m == pytest.approx(b.north_m, abs=0.05)
        deviation = np.sqrt(np.diag(a.covariance))
        assert a.velocity_north_mps == pytest.approx(b.velocity_north_mps, abs=0.05 * deviation[2])
        np.testing.assert_allclose((a.covariance - b.covariance) / np.outer(deviation, deviation), 0, atol=0.05)


def test_a_ping_between_two_samples_is_used_at_its_own_time(dive, run):
    """The same ping said to be 3 ms later is another measurement: the water has passed 0.6 mm more."""
    estimator, _ = run([m for m in dive.messages if m.t_ns <= 1_330_000_000])
    filter_ = estimator.filter
    stops = []
    advance = filter_.advance
    filter_.advance = lambda t_ns, sample: (stops.append(t_ns), advance(t_ns, sample))
    run([m for m in dive.messages if 1_330_000_000 < m.t_ns <= 1_340_000_000], estimator=estimator)
    assert stops == [1_333_333_332, 1_340_000_000]


def test_a_message_that_is_too_old_or_a_duplicate_is_counted_and_changes_nothing(dive, run, inbox_of):
    estimator, _ = run(dive.messages)
    before = estimator.filter.belief.copy()
    kinds = (ImuSample, PressureDepth, AdcpPing)
    second = [next(m for m in reversed(dive.messages) if isinstance(m, kind)) for kind in kinds]
    old = [m for m in dive.messages if 2_000_000_000 < m.t_ns < 2_700_000_000]
    for message in (*second, *old):
        assert estimator.step(message.t_ns, inbox_of(message)) == []
    np.testing.assert_array_equal(estimator.filter.belief.x, before.x)
    np.testing.assert_array_equal(estimator.filter.belief.P, before.P)
    account = estimator.account
    assert account["imu.late"] == 1 + sum(isinstance(m, ImuSample) for m in old)
    assert account["adcp.late"] == sum(isinstance(m, AdcpPing) for m in old) == 2
    assert account["pressure.late"] == sum(isinstance(m, PressureDepth) for m in old)
    assert (account["adcp.duplicate"], account["pressure.duplicate"]) == (1, 1)


def test_lost_inertial_samples_are_bridged_and_counted(dive, run):
    kept = [m for m in dive.messages if not (isinstance(m, ImuSample) and 1_000_000_000 < m.t_ns <= 1_050_000_000)]
    estimator, out = run(kept)
    assert estimator.account["imu.gap"] == 1
    assert estimator.filter.belief.t_ns == 4_000_000_000
    assert [said.t_ns for _, said in out] == [said.t_ns for _, said in run(dive.messages)[1]]


def test_the_queue_of_measurements_is_bounded_without_an_inertial_unit(dive, run, inbox_of):
    estimator, _ = run(dive.messages)
    for k in range(1, 1101):
        message = PressureDepth(t_ns=4_000_000_000 + k, depth_m=0.8)
        estimator.step(message.t_ns, inbox_of(message))
    assert estimator.account["pressure.without_imu"] == 100


def test_estimates_off_the_inertial_grid_are_made_at_their_own_time(dive, run):
    config = msgspec.structs.replace(CONFIG, estimate_period_ns=333_333_333)
    _, out = run(dive.messages, config)
    assert [said.t_ns % 333_333_333 for _, said in out] == [0] * len(out)
    at = next(said for _, said in out if said.t_ns == 3 * 333_333_333)
    near = dive.at(1_000_000_000)
    # within 1 ns of it, the vehicle is where the truth is, to the filter's deviation
    assert abs(at.depth_m - dive.position[near, 2]) < 0.02


def test_messages_of_one_inbox_are_used_as_if_they_came_one_by_one(dive, run, inbox_of):
    _, out = run(dive.messages)
    together = Estimator(SUITE, CONFIG)
    said = together.step(0, [entry for m in dive.messages for entry in inbox_of(m)])
    said = [one for one in said if isinstance(one, Estimate)]
    assert len(said) == len(out)
    assert all(same(a, b) for (_, a), b in zip(out, said, strict=True))


def test_yaw_rate_and_heading_are_the_vehicles_within_their_deviations(dive, run):
    """Heading rate from Euler angles of the truth."""
    _, out = run(dive.messages)
    said = [s for _, s in out if 1_000_000_000 <= s.t_ns < 4_000_000_000]
    k = [dive.at(s.t_ns) for s in said]
    heading = np.unwrap(np.arctan2(dive.R[:, 1, 0], dive.R[:, 0, 0]))
    rate = np.array([(heading[i] - heading[i - 1]) / 0.01 for i in k])
    error = np.array([s.yaw_rate_radps for s in said]) - rate
    deviation = np.sqrt([s.covariance[5, 5] for s in said])
    assert np.abs(error / deviation).max() < 4
    assert 0.5 < np.std(error / deviation) < 1.6
    off = np.array([s.heading_rad for s in said]) - np.arctan2(dive.R[k, 1, 0], dive.R[k, 0, 0])
    assert np.abs(np.arctan2(np.sin(off), np.cos(off))).max() < 4 * np.sqrt(said[0].covariance[4, 4])


def test_the_published_covariance_is_the_beliefs_mapped_to_published_quantities():
    """Against estimates made of beliefs that are a small error away, one state at a time."""
    rng = np.random.default_rng(0)
    layout = Layout.of(SUITE, CONFIG)
    belief = Belief.blank(layout, 0)
    belief.x = rng.standard_normal(layout.size)
    belief.R = np.linalg.qr(np.eye(3) + 0.1 * rng.standard_normal((3, 3)))[0]
    belief.R *= np.sign(np.linalg.det(belief.R))
    filter_ = ErrorStateFilter(SUITE, CONFIG, belief)
    noise = estimate(filter_, grid(CONFIG)).covariance

    def numbers(k, h):
        other = belief.copy()
        error = np.zeros(layout.size)
        error[k] = h
        other.apply_error(error)
        e = estimate(ErrorStateFilter(SUITE, CONFIG, other), grid(CONFIG))
        return np.array(
            [e.north_m, e.east_m, e.velocity_north_mps, e.velocity_east_mps, e.heading_rad, e.yaw_rate_radps]
        )

    h = 1e-6
    J = np.stack([(numbers(k, h) - numbers(k, -h)) / (2 * h) for k in range(15)], axis=1)
    J[5, 6:9] = 0  # rate times an attitude error of a mrad: left out
    root = rng.standard_normal((15, 15))
    belief.P[:15, :15] = root @ root.T
    said = estimate(filter_, grid(CONFIG)).covariance
    np.testing.assert_allclose(said - noise, J @ root @ root.T @ J.T, rtol=1e-6, atol=1e-8)
    to_yaw2 = 1.0 / (1.0 - belief.R[2, 0] ** 2)
    dt = SUITE.imu.period_ns * 1e-9
    assert noise[5, 5] == pytest.approx(SUITE.imu.angle_random_walk_rad_per_rts**2 / dt * to_yaw2)
