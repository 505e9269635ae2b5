"""Compensation of the delay: prediction to the plan's start by the sent commands and the lag; the expected delay."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from ltv_mpc import CurrentProfile, Estimate, Vehicle
from ltv_mpc.control.config import Disturbance
from ltv_mpc.control.delay import Delay
from ltv_mpc.control.disturbance import DisturbanceObserver
from ltv_mpc.control.prediction import Prediction, SentCommands, currents_at_depths, growth_m
from ltv_mpc.messages import Applied, CycleTiming
from ltv_mpc.safety.plan_gate import PlanGate, PlanVerdict
from ltv_mpc.vehicle.dynamics import heave_acceleration, rates
from tests.ltv_mpc.estimates import moving, water
from tests.ltv_mpc.plans import plan_of
from tests.ltv_mpc.reports import report
from tests.ltv_mpc.vehicles import changed

PAPER = Vehicle.load("paper")
P = PAPER.coefficients()
PROFILE = CurrentProfile(
    depth_m=np.array([0.0, 10.0, 11.0, 40.0]),
    north_mps=np.array([0.0, 0.02, 0.1, 0.1]),
    east_mps=np.array([0.05, 0.05, -0.05, 0.0]),
)


def sent() -> Prediction:
    prediction = Prediction(PAPER)
    prediction.sent.add(plan_of(0, [[0, 0, 0], [25, -10, 30], [5, 20, 60], [-20, 30, 62.5], [-20, 30, 62.5]]))
    return prediction


def estimate(t_ns: int) -> Estimate:
    place = {"north_m": 1.0, "east_m": -2.0, "depth_m": 10.2, "heading_rad": 0.7, "yaw_rate_radps": 0.1}
    return moving((0.1, 0.02), t_ns=t_ns, velocity_down_mps=0.15, current=PROFILE, **place)


def applied(t_ns: int, thrust=(0.0, 0.0, 0.0), **changes) -> Applied:
    return report(t_ns, thrust, **{"plan_epoch": 1, "plan_sequence": 0} | changes)


def test_the_prediction_agrees_with_an_independent_integration():
    prediction = sent()
    prediction.add_report(applied(100_000_000, (8.0, -3.0, 10.0)))
    start = prediction.state_at(estimate(200_000_000), 1_000_000_000)
    c0 = currents_at_depths(PROFILE, np.array([10.2]))[0]
    turn = np.exp(-1j * 0.7) * ((0.1 - c0[0]) + 1j * (0.02 - c0[1]))

    def rhs(t, y):
        u = prediction.sent.at(np.array([round(t * 1e9)]))[0]
        c = currents_at_depths(PROFILE, y[8:9])[0]
        slope = (currents_at_depths(PROFILE, y[8:9] + 1e-6)[0] - currents_at_depths(PROFILE, y[8:9] - 1e-6)[0]) / 2e-6
        dx = rates(*y[2:8], *c, *slope * y[9], P)
        lateral = (u[:2] - y[6:8]) / 0.3
        return np.concatenate([dx, lateral, [y[9], heave_acceleration(y[9], y[10], P), (u[2] - y[10]) / 0.3]])

    def lag(t, F):
        return (prediction.sent.at(np.array([round(t * 1e9)]))[0] - F) / 0.3

    # the thrust reported at 0.1 s is first brought to the estimate's time
    F = solve_ivp(lag, (0.1, 0.2), [8.0, -3.0, 10.0], max_step=0.01, rtol=1e-9).y[:, -1]
    y0 = [1.0, -2.0, turn.real, turn.imag, 0.7, 0.1, F[0], F[1], 10.2, 0.15, F[2]]
    want = solve_ivp(rhs, (0.2, 1.0), y0, max_step=0.005, rtol=1e-9, atol=1e-12).y[:, -1]
    np.testing.assert_allclose(start.X[:6], want[:6], atol=2e-4)
    np.testing.assert_allclose(start.X[6:], want[6:8], atol=1e-3)
    np.testing.assert_allclose([start.depth_m, start.sinking_mps, start.vertical_N], want[8:], atol=1e-3)
    np.testing.assert_allclose(start.command, prediction.sent.at(np.array([1_000_000_000]))[0])


@pytest.mark.parametrize("lag_s", [0.1, 3.0])
@pytest.mark.parametrize("seconds", [0.1, 30.0])
def test_without_reports_the_thrust_follows_the_lag_from_rest_before_the_first_plan(lag_s: float, seconds: float):
    """By hand: 50 N (1 - exp(-t / lag)) after a step of the command."""
    prediction = Prediction(changed(PAPER, {"thruster.port.lag_s": lag_s, "thruster.starboard.lag_s": lag_s}))
    for k in range(100):  # of a plan a cycle the older ones are forgotten
        prediction.sent.add(plan_of(k * 300_000_000, np.full((2, 3), 50.0)))
        if seconds <= 0.3 * (k + 1):
            break
    now = msgspec.structs.replace(estimate(round(seconds * 1e9)), depth_m=None)
    start = prediction.state_at(now, now.t_ns)
    np.testing.assert_allclose(start.X[6:], 50.0 * (1.0 - np.exp(-seconds / lag_s)), atol=0.02)


@pytest.mark.parametrize(
    ("lag_s", "age_s", "kept_s"), [(0.5, 0.0, 10.0), (2.0, 0.0, 16.0), (0.5, 20.0, 21.0), (0.5, 90.0, 60.0)]
)
def test_commands_are_kept_for_eight_lags_and_since_the_estimate_in_use(lag_s: float, age_s: float, kept_s: float):
    commands = SentCommands(changed(PAPER, {"thruster.port.lag_s": lag_s}))
    for t_ns in range(0, 100_000_000_000, 500_000_000):
        seen_ns = max(t_ns - round(age_s * 1e9), 0)
        commands.add(plan_of(t_ns, np.ones((2, 3)), 3_000_000_000, estimate_t_ns=seen_ns))
    assert (99.5 - commands.oldest[0] * 1e-9) == pytest.approx(kept_s, abs=0.51)


def test_a_report_newer_than_the_estimate_does_not_hide_the_one_before_it():
    prediction = sent()
    prediction.add_report(applied(200_000_000, (1.0, 2.0, 3.0)))
    prediction.add_report(applied(300_000_000, (40.0, 40.0, 40.0)))
    start = prediction.state_at(estimate(200_000_000), 200_000_000)
    np.testing.assert_allclose([*start.X[6:], start.vertical_N], [1.0, 2.0, 3.0])


def test_the_report_before_the_estimate_in_use_is_kept_however_many_follow():
    """Twenty seconds of reports at 13 Hz without a new estimate."""
    prediction = sent()
    prediction.add_report(applied(200_000_000, (1.0, 2.0, 3.0)))
    prediction.state_at(estimate(200_000_000), 200_000_000)
    for k in range(1, 261):
        prediction.add_report(applied(200_000_000 + k * 77_000_000, (40.0, 40.0, 40.0)))
        start = prediction.state_at(estimate(200_000_000), 200_000_000)
    np.testing.assert_allclose([*start.X[6:], start.vertical_N], [1.0, 2.0, 3.0])
    start = prediction.state_at(estimate(20_000_000_000), 20_000_000_000)  # of the reports since
    assert start.X[6] > 10.0


def test_the_current_is_constant_beyond_the_profile_and_zero_without_one():
    np.testing.assert_allclose(
        currents_at_depths(PROFILE, np.array([-1.0, 10.5, 99.0])), [[0, 0.05], [0.06, 0], [0.1, 0]]
    )
    np.testing.assert_array_equal(currents_at_depths(None, np.array([5.0])), [[0.0, 0.0]])


# --- expected delay --------------------------------------------------------------------------------------------------


def timing(compute_ns: int) -> CycleTiming:
    return CycleTiming(t_ns=0, compute_ns=compute_ns, compute_wall_ns=0, estimate_age_ns=0, stage_us={})


def test_the_computing_time_is_used_until_the_actuators_report():
    delay = Delay(0, 1.0)
    delay.add_timing(timing(400))
    assert delay.expected_ns == 400
    delay.add_receipt(applied(10, plan_cycle_t_ns=1000, plan_received_t_ns=1700))
    assert delay.expected_ns == 700


def received(delay: Delay, *took_ns: int) -> None:
    for k, took in enumerate(took_ns):
        at = 1_000_000 * (k + 1) + len(took_ns)
        for _ in range(3):  # the actuators repeat their report
            delay.add_receipt(applied(10, plan_cycle_t_ns=at, plan_received_t_ns=at + took))


def test_the_expected_delay_is_at_least_min_ns():
    delay = Delay(0, 1.0, 30)
    assert delay.expected_ns == 30
    delay.add_timing(timing(10))
    assert delay.expected_ns == 30
    delay.add_timing(timing(40))
    assert delay.expected_ns == 40  # the median of two is the later one


def test_expected_is_a_quantile_plus_its_distance_from_the_median():
    delay = Delay(0, 1.0)
    received(delay, 100, 100, 100, 160)  # each receipt is counted once, although it is reported three times
    assert delay.expected_ns == 160 + (160 - 100)


def test_a_receipt_after_the_end_of_the_plan_is_not_counted():
    delay = Delay(50, 1.0, plan_ns=1000)
    received(delay, *[1001] * 20)
    assert delay.expected_ns == 50
    received(delay, *[1000] * 21)
    assert delay.expected_ns == 1000


@pytest.mark.parametrize("share", [0.02, 0.05])
def test_rare_delays_that_are_much_longer_are_not_expected(share):
    draws = np.random.default_rng(1)
    usual_ns = draws.normal(50e6, 5e6, size=2000)
    late = draws.random(2000) < share
    delay, expected = Delay(50_000_000, 0.98), []
    for took_ns in usual_ns + 1e9 * late:
        delay.add_timing(timing(round(took_ns)))
        expected.append(delay.expected_ns)
    settled = np.array(expected[20:])
    assert settled.max() < 120_000_000
    punctual = usual_ns[21:][~late[21:]] <= settled[:-1][~late[21:]]
    assert punctual.mean() > 0.999


def test_a_change_of_the_delay_is_followed_after_five_longer_or_twenty_shorter_ones():
    draws = np.random.default_rng(2)
    delay = Delay(50_000_000, 0.98)

    def measure(count, mean_ns):
        for took_ns in draws.normal(mean_ns, 2e6, size=count):
            delay.add_timing(timing(round(took_ns)))
        return delay.expected_ns

    measure(100, 50e6)
    assert measure(4, 400e6) < 100_000_000
    assert 400_000_000 < measure(1, 400e6) < 420_000_000
    assert 400_000_000 < measure(95, 400e6) < 420_000_000
    assert measure(20, 50e6) < 70_000_000


def test_a_report_without_an_accepted_plan_is_no_receipt():
    delay = Delay(5, 1.0)
    delay.add_receipt(applied(10, plan_sequence=-1))
    assert delay.expected_ns == 5
    for of_other, expected in ((8, 8), (3, 5)):  # without measurements, what another controller expected counts
        delay.restore(of_other, (), ())
        assert delay.expected_ns == expected


# --- growth of the uncertainty, against draws of the estimate, the current and the thrust ---

S = 1_000_000_000
PLACE = {"north_m": 3.0, "east_m": -2.0, "heading_rad": 0.6, "yaw_rate_radps": 0.05}
MOVING = moving((0.25, 0.15), current=water(), **PLACE)
SD = np.array([0.4, 0.2, 0.02, 0.03, 0.05, 0.01])
"""Of north, east, velocity north and east, heading, yaw rate."""
CORRELATED = np.diag(SD) @ (np.eye(6) + 0.4 * (np.eye(6, k=2) + np.eye(6, k=-2))) @ np.diag(SD)


def learning(walk_mps_per_rts: float = 0.01, sd_mps: float | None = None) -> DisturbanceObserver:
    """Return the bias after one estimate without a current."""
    bias = DisturbanceObserver(Disturbance(sd_mps=sd_mps, walk_mps_per_rts=walk_mps_per_rts), PAPER)
    bias.correct(Estimate.at_rest(), Prediction(PAPER))
    return bias


NEVER = learning(sd_mps=0.0)


def pushed(port: float = 1.0, starboard: float = 1.0) -> Prediction:
    """Return a prediction through commands of 8 s, each thruster's scaled."""
    prediction = Prediction(PAPER)
    prediction.sent.add(plan_of(0, np.tile([30.0 * port, 22.0 * starboard, 0.0], (28, 1))))
    return prediction


def drawn(t_ns: int, covariance: np.ndarray | None, current_sd: float) -> float:
    """Return the standard deviation of the predicted position over 400 draws (m)."""
    rng = np.random.default_rng(1)
    factor = np.zeros((6, 6)) if covariance is None else np.linalg.cholesky(covariance)
    places = np.empty((400, 2))
    for k in range(400):
        n, e, vn, ve, psi, r = factor @ rng.standard_normal(6)
        cn, ce = current_sd * rng.standard_normal(2)
        place = {"north_m": 3.0 + n, "east_m": -2.0 + e, "heading_rad": 0.6 + psi, "yaw_rate_radps": 0.05 + r}
        estimate = moving((0.25 + vn, 0.15 + ve), current=water(cn, ce), **place)
        places[k] = pushed(*(1.0 + 0.1 * rng.standard_normal(2))).state_at(estimate, t_ns).X[:2]
    return float(np.sqrt(places.var(axis=0).sum()))


@pytest.mark.parametrize(
    ("covariance", "bias"),
    [(None, NEVER), (CORRELATED, NEVER), (None, learning()), (CORRELATED, learning())],
)
def test_the_growth_is_that_of_draws(covariance, bias):
    estimate, seconds = msgspec.structs.replace(MOVING, covariance=covariance), 6
    growth = growth_m(pushed(), estimate, seconds * S, bias.covariance_of_mean(seconds))
    at_first = 0.0 if covariance is None else float(np.hypot(*SD[:2]))
    current_sd = 0.0 if bias is NEVER else float(np.sqrt(bias.covariance_of_mean(seconds)[0, 0]))
    assert growth == pytest.approx(drawn(seconds * S, covariance, current_sd) - at_first, rel=0.15)


def test_a_random_walk_of_the_current_adds_up():
    """By hand: the position of a drifting vehicle has the variance q^2 t^3 / 3 from a walk of q."""
    bias = learning(0.02)
    added = bias.covariance_of_mean(9.0) - bias.covariance
    np.testing.assert_allclose(added * 9.0**2, 0.02**2 * 9.0**3 / 3.0 * np.eye(2))


def test_the_standard_deviation_of_a_told_current_counts_at_the_depth_of_the_vehicle():
    zero = np.zeros(2)
    profile = CurrentProfile(depth_m=np.array([0.0, 10.0]), north_mps=zero, east_mps=zero, sd_mps=np.array([0.0, 0.2]))
    estimate = msgspec.structs.replace(MOVING, depth_m=5.0, current=profile)
    growth = growth_m(pushed(), estimate, 6 * S, NEVER.covariance_of_mean(6.0))
    assert growth == pytest.approx(drawn(6 * S, None, 0.1), rel=0.15)
    assert growth > 1.5 * growth_m(pushed(), MOVING, 6 * S, NEVER.covariance_of_mean(6.0))


# --- commands in force, by time ---


def test_a_plan_is_in_force_from_its_first_knot_and_the_next_takes_over_at_its_own():
    sent = SentCommands(PAPER)
    sent.add(plan_of(0, [[0, 0, 0], [30, -30, 10], [60, -60, 20]]))
    sent.add(plan_of(150_000_000, [[15, -15, 5], [0, 0, 0], [0, 0, 0]]))
    at = sent.at(np.array([75_000_000, 150_000_000, 300_000_000, 450_000_000]))
    np.testing.assert_allclose(at[:, :2].T, [[7.5, 15.0, 7.5, 0.0], [-7.5, -15.0, -7.5, 0.0]], atol=1e-6)


def test_after_the_last_knot_every_thruster_ramps_to_rest_at_its_own_slew_limit():
    vehicle = msgspec.structs.replace(PAPER, failsafe_vertical_N=-10.0)
    sent = SentCommands(vehicle)
    sent.add(plan_of(0, [[0, 0, 0], [20, -10, 30]]))
    end = 300_000_000
    at = sent.at(np.array([end, end + 100_000_000, end + 200_000_000, end + 400_000_000, end + 2 * S]))
    np.testing.assert_allclose(at.T, [[20, 10, 0, 0, 0], [-10, 0, 0, 0, 0], [30, 20, 10, -10, -10]], atol=1e-6)


@given(
    plan_timeout_s=st.floats(0.5, 6.0),
    period_s=st.sampled_from([0.3, 0.7, 2.1]),
    cycles=st.integers(2, 4),
    seed=st.integers(0, 2**32 - 1),
)
def test_the_commands_in_force_are_those_of_the_actuators_when_plans_stop(plan_timeout_s, period_s, cycles, seed):
    """Plans of 6 s come at their start, and then none: the gate goes to rest, and the controller predicts it."""
    vehicle = msgspec.structs.replace(PAPER, plan_timeout_s=plan_timeout_s, failsafe_vertical_N=-10.0)
    period_ns = round(period_s * S)
    gate, sent = PlanGate(vehicle), SentCommands(vehicle, period_ns)
    gate.command_at(0)
    change = np.random.default_rng(seed).uniform(-30.0, 30.0, (21, 3))
    for k in range(cycles):
        start = k * period_ns
        change[0] = gate.command_at(start)
        one = plan_of(start, np.clip(np.cumsum(change, axis=0), -62.5, 62.5))
        sent.add(one)
        assert gate.offer(one, 1, k, start) is PlanVerdict.ACCEPTED
    times = np.arange(start, start + 10 * S, 10_000_000)
    # The gate notices an end within one of its steps, in which the command changes by 1 N at most.
    np.testing.assert_allclose(sent.at(times), [gate.command_at(t) for t in times.tolist()], atol=2.0)


def test_two_thrusters_that_come_to_rest_together_have_one_knot():
    """The times differ by a rounding error; a prediction over a stage of no length would not be finite."""
    sent = SentCommands(PAPER)
    sent.add(plan_of(0, [[0, 0, 0], [62.5, np.nextafter(62.5, 0.0), 30.0]]))
    t, thrust = sent.knots
    np.testing.assert_array_equal(t, [-1, 0, 300_000_000, 600_000_000, 925_000_000])  # at rest before it
    np.testing.assert_allclose(thrust[-1], 0.0, atol=1e-6)


def test_from_a_reported_command_the_plan_is_approached_at_the_slew_limit():
    """A plan came late, or the controller has just started: the next plan begins at the command in force."""
    sent = SentCommands(PAPER)
    sent.add(plan_of(0, np.full((10, 3), 40.0)))
    sent.correct(1_000_000_000, (10.0, 40.0, 62.5))
    at = sent.at(np.array([1_000_000_000, 1_200_000_000, 1_300_000_000, 2_000_000_000]))
    np.testing.assert_allclose(at.T, [[10, 30, 40, 40], [40, 40, 40, 40], [62.5, 42.5, 40, 40]], atol=0.02)


@pytest.mark.parametrize("thruster", range(3))
def test_one_thruster_with_another_command_is_a_difference(thruster):
    """Each thruster by itself, between knots; a rounding error is no difference."""
    sent = SentCommands(PAPER)
    sent.add(plan_of(0, [[0, 0, 0], [30, -30, 10], [60, -60, 20], [10, 40, -20]]))
    before = [part.copy() for part in sent.knots]
    now = sent.at(np.array([750_000_000]))[0]
    sent.correct(750_000_000, tuple(now + 0.005))
    np.testing.assert_array_equal(sent.knots[1], before[1])
    now[thruster] += 1.0
    sent.correct(750_000_000, tuple(now))
    np.testing.assert_allclose(sent.at(np.array([750_000_000]))[0], now)


def test_without_a_plan_a_reported_command_ramps_to_rest():
    sent = SentCommands(PAPER)
    sent.correct(0, (50.0, -50.0, 20.0))
    at = sent.at(np.array([0, 250_000_000, 500_000_000, S]))
    np.testing.assert_allclose(at[:, :2].T, [[50.0, 25.0, 0.0, 0.0], [-50.0, -25.0, 0.0, 0.0]], atol=0.02)
