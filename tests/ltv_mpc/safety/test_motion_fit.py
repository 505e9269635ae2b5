"""Motion fit: late stamps, a wrong file and wind are told apart, and a right file in right stamps looks like none."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest

from ltv_mpc.messages import Estimate
from ltv_mpc.safety.motion_fit import ARM, DELAY, KEPT_S, MODEL, MotionFit, ThrustImpulse
from ltv_mpc.vehicle.dynamics import rates
from ltv_mpc.vehicle.parameters import Vehicle
from tests.ltv_mpc.estimates import moving
from tests.ltv_mpc.vehicles import off_by

VEHICLE = Vehicle.load("bluerobotics-boat")
MAX_N = VEHICLE.thrusters[0].max_N
STEP_S = 0.01


def ns(seconds: float) -> int:
    """Return a time in ns."""
    return round(seconds * 1e9)


@cache
def steered(seconds: float, *, mass: float = 1.0, drag: float = 1.0, port: float = 1.0, wind_mps2: float = 0.0):
    """Return times, states (n', e', psi, r) over ground and thrusts of the vehicle with factors, in a current.

    Each second both thrusters move towards other random thrusts; ``port`` is the share that port delivers, and the wind
    from the south accelerates the vehicle of the file so much.
    """
    file = VEHICLE.coefficients()
    p = off_by(file, mass=mass, drag=drag)
    force = -0.5 * wind_mps2 * (file.mass_surge + file.mass_sway) / p.dry_mass  # as of water that accelerates
    rng = np.random.default_rng(3)
    steps = round(seconds / STEP_S)
    knots = 0.6 * MAX_N * rng.uniform(-0.5, 1.0, (round(seconds) + 2, 2))
    t = STEP_S * np.arange(steps)
    thrust = np.stack([np.interp(t, np.arange(len(knots)), knots[:, i]) for i in range(2)], axis=1)
    u = v = psi = r = 0.0
    states = np.empty((steps, 4))
    for k in range(steps):
        states[k] = u * math.cos(psi) - v * math.sin(psi) + 0.2, u * math.sin(psi) + v * math.cos(psi) - 0.1, psi, r
        _, _, du, dv, _, dr = rates(u, v, psi, r, port * thrust[k, 0], thrust[k, 1], 0.0, 0.0, force, 0.0, p)
        u, v, r, psi = u + STEP_S * du, v + STEP_S * dv, r + STEP_S * dr, psi + STEP_S * r
    return t, states, thrust


def fitted(
    late_s: float = 0.0, jitter_s: float = 0.0, *, seconds: float = 90.0, noise: float = 0.0, reports: bool = True,
    arm_m: float = 0.0, **true: float,
) -> MotionFit:  # fmt: skip
    """Return the fit after a flight; the states are older than their stamps by ``late_s`` +- ``jitter_s``."""
    t, states, thrust = steered(seconds, **true)
    rng, fit = np.random.default_rng(4), MotionFit(VEHICLE)
    for k in range(0, len(t), 30):
        fit.add_thrust(ns(t[k]), (*thrust[k].tolist(), 0.0), reported=reports)
        shown = states[max(k - round((late_s + jitter_s * rng.uniform(-1.0, 1.0)) / STEP_S), 0)]
        fit.update(estimate(t[k], shown + noise * rng.standard_normal(4) * (1.0, 1.0, 0.1, 0.3), arm_m))
    return fit


def estimate(t_s: float, state, arm_m: float = 0.0) -> Estimate:
    """Return the estimate of a state (n', e', psi, r) of a point ahead of the origin."""
    north, east, psi, r = state.tolist()
    velocity_mps = north - r * arm_m * math.sin(psi), east + r * arm_m * math.cos(psi)
    return moving(velocity_mps, t_ns=ns(t_s), heading_rad=psi, yaw_rate_radps=r)


WRONG = {"mass": 2.0, "drag": 0.5}


@pytest.mark.parametrize("late_s", [0.5, 1.0])
@pytest.mark.parametrize("true", [{}, WRONG, {"port": 0.5}, {"wind_mps2": 0.1}])
def test_a_delay_is_found_within_30_s_whatever_the_vehicle_is(late_s, true):
    fit = fitted(late_s, seconds=30.0, **true)
    assert fit.certain[DELAY] > 0.15
    assert fit.x[DELAY] == pytest.approx(late_s, abs=0.1)


@pytest.mark.parametrize("true", [{}, WRONG, {"port": 0.5}, {"noise": 0.03}, {"wind_mps2": 0.1}, {"reports": False}])
def test_right_stamps_are_never_late(true):
    assert fitted(**true).certain[DELAY] == 0.0


@pytest.mark.parametrize("true", [{"wind_mps2": 0.1}, {"noise": 0.03}, {"port": 0.5}, {"port": 0.5, "wind_mps2": 0.1}])
def test_neither_wind_nor_noise_nor_a_weak_thruster_is_another_vehicle(true):
    fit = fitted(**true)
    assert np.abs(fit.certain[MODEL:DELAY]).max() < 0.15
    assert math.hypot(*fit.certain[ARM:MODEL]) < 0.1


@pytest.mark.parametrize("wind_mps2", [0.0, 0.1])
def test_a_wrong_file_is_measured_also_in_wind(wind_mps2):
    fit = fitted(**WRONG, wind_mps2=wind_mps2, noise=0.005)
    mass, _, inertia, ahead, _, yaw = np.exp(fit.x[MODEL : MODEL + 6]).tolist()
    assert (mass, inertia) == pytest.approx((2.0, 2.0), rel=0.1)
    assert (ahead, yaw) == pytest.approx((0.5, 0.5), rel=0.1)


def test_another_reference_point_is_measured():
    assert fitted(arm_m=0.5, noise=0.005).x[ARM:MODEL] == pytest.approx((0.5, 0.0), abs=0.05)


def test_without_reports_the_thrust_is_the_predicted_one_and_reports_replace_it():
    predicted = fitted(0.5, reports=False)
    assert predicted.x[DELAY] == pytest.approx(0.5, abs=0.1)
    assert not predicted.reported_ns
    fit = MotionFit(VEHICLE)
    t, states, thrust = steered(30.0)
    for k in range(0, len(t), 30):  # a prediction that knows nothing of a dead time of 0.5 s
        fit.add_thrust(ns(t[k]), (*thrust[k].tolist(), 0.0))
        fit.add_thrust(ns(t[k]) + 1, (*thrust[min(k + 50, len(t) - 1)].tolist(), 0.0), reported=False)
        fit.update(estimate(t[k], states[k]))
    assert fit.reported_ns
    assert fit.certain[DELAY] == 0.0


def test_the_delay_ends_after_the_stamps_are_mended_and_a_clock_that_is_set_back_begins_again():
    t, states, thrust = steered(210.0)
    fit, found = MotionFit(VEHICLE), []
    for k in range(0, len(t), 30):
        fit.add_thrust(ns(t[k]), (*thrust[k].tolist(), 0.0))
        fit.update(estimate(t[k], states[max(k - 50, 0) if t[k] < 60.0 else k]))
        found.append(fit.x[DELAY] * (fit.certain[DELAY] > 0.0))
    assert found[190] == pytest.approx(0.5, abs=0.1)
    assert found[-1] == 0.0
    for k in range(0, 12000, 30):
        fit.add_thrust(ns(t[k]), (*thrust[k].tolist(), 0.0))
        fit.update(estimate(t[k], states[max(k - 50, 0)]))
    assert fit.x[DELAY] == pytest.approx(0.5, abs=0.1)


# --- impulse of the reported thrusts ---

S = 1_000_000_000
KEPT_NS = round(KEPT_S * S)


def test_the_impulse_is_the_integral_of_thrusts_that_are_linear_between_reports():
    impulse = ThrustImpulse()
    for t_s, thrust in ((0, (0.0, 4.0)), (1, (2.0, 4.0)), (3, (2.0, -4.0))):
        impulse.add(t_s * S, [*thrust, 0.0])
    assert impulse.until(S // 2) == pytest.approx((0.25, 2.0))
    assert impulse.until(2 * S) == pytest.approx((3.0, 6.0))
    assert impulse.until(4 * S) == pytest.approx((7.0, 0.0))  # constant after the last report


def test_before_the_first_report_the_impulse_is_unknown():
    impulse = ThrustImpulse()
    assert impulse.until(0) is None
    impulse.add(S, [1.0, 1.0, 0.0])
    assert impulse.until(S - 1) is None


@pytest.mark.parametrize("period_ns", [5_000_000, S // 10, 2 * S])
def test_reports_are_kept_by_their_age_and_not_by_their_number(period_ns):
    impulse, count = ThrustImpulse(), 10 * S // period_ns
    for k in range(count + 1):
        impulse.add(k * period_ns, [3.0, -1.0, 0.0])
    newest_ns = count * period_ns
    assert impulse.until(newest_ns - KEPT_NS) == pytest.approx((15.0, -5.0))
    assert impulse.until(newest_ns - KEPT_NS - 2 * period_ns - S) is None


def test_a_repeated_report_changes_nothing():
    impulse = ThrustImpulse()
    for _ in range(3):
        impulse.add(0, [1.0, 1.0, 0.0])
    assert impulse.until(S) == (1.0, 1.0)
