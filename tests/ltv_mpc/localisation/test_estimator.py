"""The estimator node: when it publishes, in which order it uses messages, and what an estimate contains."""

import numpy as np
import pytest
from msgspec.structs import replace

from ltv_mpc.localisation.estimator import Estimator
from ltv_mpc.localisation.filter.error_state_filter import ErrorStateFilter
from ltv_mpc.localisation.filter.state import Belief, Layout, grid
from ltv_mpc.localisation.publishing import estimate
from ltv_mpc.localisation.sensors import BY_MESSAGE
from ltv_mpc.messages import AdcpPing, BottomTrack, CompassHeading, Estimate, GnssFix, ImuSample, PressureDepth, TdcpFix
from tests.ltv_mpc.localisation.dives import CONFIG, REALISTIC, Run, S, dive, error_of, inbox
from tests.ltv_mpc.localisation.sensors.every_sensor import EVERY_SENSOR

PERIOD_NS = CONFIG.estimate_period_ns
DIVE = dive(REALISTIC, 5, duration_s=4.0)


@pytest.fixture(scope="module")
def usual():
    return Run(DIVE.messages)


def causes(run):
    """Return the message whose step published each estimate, by the estimate's time."""
    return {e.t_ns: cause for cause, out in run.steps for e in out if isinstance(e, Estimate)}


def test_it_publishes_once_a_period_from_alignment_on_with_the_last_message_due(usual):
    by = causes(usual)
    assert list(by) == list(range(-900_000_000, 4 * S + 1, PERIOD_NS))
    assert isinstance(by[0], CompassHeading)
    assert isinstance(by[S], CompassHeading)
    assert isinstance(by[1_100_000_000], PressureDepth)
    assert all(cause.t_ns == t_ns for t_ns, cause in by.items() if t_ns >= -700_000_000)


def test_until_it_is_aligned_it_publishes_nothing_and_names_what_it_waits_for(usual):
    run = Run(m for m in DIVE.messages if not isinstance(m, CompassHeading))
    assert not run.estimates
    assert run.estimator.waiting_for.startswith("compass")
    assert usual.estimator.waiting_for == ""


def test_an_estimate_holds_everything_measured_at_its_time(usual):
    """The carrier phase at 0 brings the velocity from 2 cm/s to below 1: it must be in the estimate of 0."""
    before, at_zero = (np.sqrt(usual.estimates[t_ns].covariance[2, 2]) for t_ns in (-PERIOD_NS, 0))
    assert at_zero < 0.008 < 0.012 < before


def test_a_sensor_that_is_silent_does_not_hold_the_estimate_for_more_than_one_sample():
    by = causes(Run(m for m in DIVE.messages if not (isinstance(m, PressureDepth) and m.t_ns > 0)))
    late = {t_ns: cause.t_ns - t_ns for t_ns, cause in by.items() if t_ns > 0}
    assert list(late) == list(range(PERIOD_NS, 4 * S, PERIOD_NS))
    assert max(late.values()) <= 10_000_000


@pytest.mark.parametrize(("latency_ns", "last"), [(0, BottomTrack), (20_000_000, PressureDepth)])
def test_an_estimate_waits_for_a_bottom_track_without_latency(latency_ns, last):
    """Ten bottom tracks a second, each the last message of its instant."""
    tracking = replace(EVERY_SENSOR.bottom_track, period_ns=PERIOD_NS, latency_ns=latency_ns)
    nothing = np.full(4, np.nan)
    pings = [BottomTrack(t_ns=k * PERIOD_NS, range_m=nothing, beam_velocity_mps=nothing) for k in range(-5, 41)]
    messages = sorted([*DIVE.messages, *pings], key=lambda m: (m.t_ns, isinstance(m, BottomTrack)))
    by = causes(Run(messages, replace(REALISTIC, bottom_track=tracking)))
    assert {type(cause) for t_ns, cause in by.items() if t_ns > 0 and t_ns % S} == {last}


@pytest.mark.parametrize("sensor", ["adcp", "pressure", "compass", "gnss", "tdcp"])
def test_an_estimate_does_not_wait_for_a_sensor_that_is_late_by_its_file(sensor):
    """Nor for an absent one: at -0.1 s only the pressure is due, at 0 everything but the profiler's ping."""
    late = replace(getattr(REALISTIC, sensor), latency_ns=50_000_000)
    others = [m for m in DIVE.messages if BY_MESSAGE[type(m)].name != sensor or m.t_ns < -800_000_000]
    by = causes(Run(others, replace(REALISTIC, **{sensor: late})))
    assert all(by[t_ns].t_ns == t_ns for t_ns in (-100_000_000, 0, S))


def test_the_order_of_arrival_at_one_instant_and_within_one_sample_does_not_matter(usual):
    """Aiding messages that come ahead of the inertial sample that covers them wait for it.

    Only the points of linearisation differ: a few hundredths of the deviation.
    """
    order = {ImuSample: 9, CompassHeading: 0, PressureDepth: 1, AdcpPing: 2, TdcpFix: 3, GnssFix: 4}
    first = [m for m in DIVE.messages if m.t_ns <= -700_000_000]
    rest = [m for m in DIVE.messages if m.t_ns > -700_000_000]
    swapped = Run(first + sorted(rest, key=lambda m: (-(-m.t_ns // 10_000_000), order[type(m)], m.t_ns))).estimates
    assert list(swapped) == list(usual.estimates)
    for t_ns, a in usual.estimates.items():
        b, deviation = swapped[t_ns], np.sqrt(np.diag(a.covariance))
        assert a.north_m == pytest.approx(b.north_m, abs=0.05)
        assert a.velocity_north_mps == pytest.approx(b.velocity_north_mps, abs=0.05 * deviation[2])
        np.testing.assert_allclose((a.covariance - b.covariance) / np.outer(deviation, deviation), 0, atol=0.05)


def test_a_ping_between_two_samples_is_used_at_its_own_time():
    """The same ping said to be 3 ms later is another measurement: the water has passed 0.6 mm more."""
    estimator = Run(m for m in DIVE.messages if m.t_ns <= 1_330_000_000).estimator
    filter_, stops = estimator.filter, []
    advance = filter_.advance
    filter_.advance = lambda t_ns, sample: (stops.append(t_ns), advance(t_ns, sample))
    Run((m for m in DIVE.messages if 1_330_000_000 < m.t_ns <= 1_340_000_000), estimator=estimator)
    assert stops == [1_333_333_332, 1_340_000_000]


def test_the_queue_of_measurements_is_bounded_without_an_inertial_unit():
    run = Run([*DIVE.messages, *(PressureDepth(t_ns=4 * S + k, depth_m=0.8) for k in range(1, 1101))])
    assert run.estimator.account["pressure.without_imu"] == 100


def test_estimates_off_the_inertial_grid_are_made_at_their_own_time():
    estimates = Run(DIVE.messages, config=replace(CONFIG, estimate_period_ns=333_333_333)).estimates
    assert {t_ns % 333_333_333 for t_ns in estimates} == {0}
    assert abs(estimates[3 * 333_333_333].depth_m - DIVE.position[DIVE.at(S), 2]) < 0.02


def test_messages_of_one_inbox_are_used_as_if_they_came_one_by_one(usual):
    out = Estimator(REALISTIC, CONFIG).step(0, [entry for m in DIVE.messages for entry in inbox(m)])
    together = [one for one in out if isinstance(one, Estimate)]
    assert [e.t_ns for e in together] == list(usual.estimates)
    for e in together:
        np.testing.assert_array_equal(e.covariance, usual.estimates[e.t_ns].covariance)


def test_yaw_rate_and_heading_are_the_vehicles_within_their_deviations(usual):
    """Heading rate from Euler angles of the truth."""
    heading = np.unwrap(np.arctan2(DIVE.R[:, 1, 0], DIVE.R[:, 0, 0]))
    shown = [e for t_ns, e in usual.estimates.items() if S <= t_ns < 4 * S]
    rate = np.array([(heading[k] - heading[k - 1]) / 0.01 for k in (DIVE.at(e.t_ns) for e in shown)])
    error = (np.array([e.yaw_rate_radps for e in shown]) - rate) / np.sqrt([e.covariance[5, 5] for e in shown])
    assert np.abs(error).max() < 4
    assert 0.5 < np.std(error) < 1.6
    assert all(abs(error_of(e, DIVE)[4]) < 4 * np.sqrt(e.covariance[4, 4]) for e in shown)


def test_the_published_covariance_is_the_beliefs_mapped_to_published_quantities():
    """Against estimates made of beliefs that are a small error away, one state at a time."""
    rng = np.random.default_rng(0)
    layout = Layout.of(REALISTIC, CONFIG)
    belief = Belief.blank(layout, 0)
    belief.x = rng.standard_normal(layout.size)
    belief.R = np.linalg.qr(np.eye(3) + 0.1 * rng.standard_normal((3, 3)))[0]
    belief.R *= np.sign(np.linalg.det(belief.R))
    filter_ = ErrorStateFilter(REALISTIC, CONFIG, belief)
    noise = estimate(filter_, grid(CONFIG)).covariance

    def numbers(error):
        other = belief.copy()
        other.apply_error(error)
        e = estimate(ErrorStateFilter(REALISTIC, CONFIG, other), grid(CONFIG))
        names = "north_m", "east_m", "velocity_north_mps", "velocity_east_mps", "heading_rad", "yaw_rate_radps"
        return np.array([getattr(e, name) for name in names])

    J = np.stack([(numbers(e) - numbers(-e)) / 2e-6 for e in 1e-6 * np.eye(15, layout.size)], axis=1)
    J[5, 6:9] = 0  # rate times an attitude error of a mrad: left out
    root = rng.standard_normal((15, 15))
    belief.P[:15, :15] = root @ root.T
    published = estimate(filter_, grid(CONFIG)).covariance
    np.testing.assert_allclose(published - noise, J @ root @ root.T @ J.T, rtol=1e-6, atol=1e-8)
    white = REALISTIC.imu.angle_random_walk_rad_per_rts**2 / (REALISTIC.imu.period_ns * 1e-9)
    assert noise[5, 5] == pytest.approx(white / (1.0 - belief.R[2, 0] ** 2))
