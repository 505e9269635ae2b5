"""Compensation of the delay: prediction to the plan's start by the sent commands and the lag; the expected delay."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from ltv_mpc import CurrentProfile, Estimate, Vehicle
from ltv_mpc.control.delay import Delay
from ltv_mpc.control.prediction import Prediction, SentCommands, currents_at_depths
from ltv_mpc.messages import Applied, CycleTiming
from ltv_mpc.vehicle.dynamics import heave_acceleration, rates
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
    return Estimate(
        t_ns=t_ns,
        north_m=1.0,
        east_m=-2.0,
        depth_m=10.2,
        heading_rad=0.7,
        yaw_rate_radps=0.1,
        velocity_north_mps=0.1,
        velocity_east_mps=0.02,
        velocity_down_mps=0.15,
        current=PROFILE,
    )


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
    slow = {"lag_s": lag_s}
    thruster = msgspec.structs.replace(
        PAPER.thruster,
        port=msgspec.structs.replace(PAPER.thruster.port, **slow),
        starboard=msgspec.structs.replace(PAPER.thruster.starboard, **slow),
    )
    vehicle = msgspec.structs.replace(PAPER, thruster=thruster)
    prediction = Prediction(vehicle)
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
