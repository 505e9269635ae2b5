"""Mode of a cycle: its condition, its reason, and the estimate that it names."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from ltv_mpc import Controller, ControllerConfig, Estimate, Plan, PlanOrigin, Vehicle, advance, references
from ltv_mpc.messages import Health
from ltv_mpc.safety.health import (
    NOMINAL,
    OLD_ESTIMATES,
    PREDICTED,
    PREDICTED_TOO_FAR,
    PREDICTED_TOO_LONG,
    Ages,
    HealthState,
)
from tests.ltv_mpc.control.flights import fly

SURFACES = msgspec.structs.replace(Vehicle.load("paper"), failsafe_vertical_N=-12.5)
POINT = references.Point(north_m=0.0, east_m=0.0, depth_m=10.0)
S = 1_000_000_000
PERIOD_S = 0.3
SOLVED, STOP, ZERO = PlanOrigin.SOLVED, PlanOrigin.STOP, PlanOrigin.ZERO
AGED = ControllerConfig(ages=Ages(hold_growth_m=1000.0))
"""Only the age counts."""


def flown(config: ControllerConfig = AGED, reference=POINT) -> tuple[Controller, Estimate]:
    """Return a controller after six seconds, and its last estimate."""
    controller = Controller(SURFACES, reference, config)
    way, _ = fly(controller, Estimate.at_rest(north_m=1.0, heading_rad=2.0, depth_m=5.0), 20)
    controller.plan(way[-1])
    return controller, way[-1]


def silent(controller: Controller, estimate: Estimate, until_s: float) -> list[Plan]:
    """Return the plans of a time without new estimates."""
    times = np.arange(1, round(until_s / PERIOD_S) + 1) * PERIOD_S
    return [controller.plan(estimate, t_ns=estimate.t_ns + round(t * S)) for t in times]


def changes(plans: list[Plan]) -> list[tuple[str, str, str]]:
    """Return health, its reason and origin, each time that they change."""
    states = [(plan.health.value, plan.health_why, plan.origin.value) for plan in plans]
    return [state for k, state in enumerate(states) if k == 0 or state != states[k - 1]]


def test_without_estimates_it_predicts_then_stops_then_lets_go_with_each_reason_once():
    controller, estimate = flown()
    assert changes(silent(controller, estimate, 25.0)) == [
        ("nominal", "", "solved"),
        ("degraded", PREDICTED, "solved"),
        ("hold", PREDICTED_TOO_LONG, "stop"),
        ("failsafe", OLD_ESTIMATES, "zero"),
    ]


def test_the_plans_without_estimates_are_those_of_a_vehicle_that_does_as_predicted():
    """State and thrusts of a controller that hears nothing are those of one that hears of the same motion."""
    deaf, estimate = flown()
    hearing = Controller(SURFACES, POINT, AGED)
    hearing.restore(deaf.save(estimate.t_ns), estimate.t_ns)
    hearing.plan(estimate)
    last = estimate
    for k in range(1, 31):
        plan = hearing.plan(last)
        last = advance(SURFACES, last, plan, duration_s=PERIOD_S)
        other = deaf.plan(estimate, t_ns=estimate.t_ns + round(k * PERIOD_S * S))
    np.testing.assert_allclose(other.states[0, :2], plan.states[0, :2], atol=0.05)
    assert other.origin is plan.origin is SOLVED


def test_in_hold_the_vehicle_stops_through_the_water():
    """It moves at 0.4 m/s and turns; the brake has to push astern, within the slew limit, and then gives zero."""
    ages = Ages(degraded_s=0.1, hold_s=0.2, failsafe_s=60.0, hold_growth_m=1000.0)
    controller = Controller(SURFACES, POINT, ControllerConfig(ages=ages))
    moving = msgspec.structs.replace(Estimate.at_rest(depth_m=10.0), velocity_north_mps=0.4, yaw_rate_radps=0.2)
    controller.plan(moving)
    truth, plans = advance(SURFACES, moving, controller.plan(moving), duration_s=PERIOD_S), []
    for _ in range(25):
        plans.append(controller.plan(moving, t_ns=truth.t_ns))
        truth = advance(SURFACES, truth, plans[-1], duration_s=PERIOD_S)
    assert {plan.origin for plan in plans} == {STOP}
    assert min(plan.thrust_N[:, :2].sum(axis=1).min() for plan in plans) < -20.0
    heading = (math.cos(truth.heading_rad), math.sin(truth.heading_rad))
    assert abs(truth.velocity_north_mps * heading[0] + truth.velocity_east_mps * heading[1]) < 0.02
    assert abs(truth.yaw_rate_radps) < 0.01
    assert np.abs(plans[-1].thrust_N[:, :2]).max() < 1.0


def test_a_prediction_that_grows_too_uncertain_is_held_until_the_next_estimate():
    config = ControllerConfig(ages=Ages(hold_growth_m=0.1))
    controller, estimate = flown(config)
    plans = silent(controller, estimate, 9.0)
    assert changes(plans) == [
        ("nominal", "", "solved"),
        ("degraded", PREDICTED, "solved"),
        ("hold", PREDICTED_TOO_FAR, "stop"),
    ]
    assert controller.health(estimate.t_ns + 9 * S) == HealthState(Health.HOLD, PREDICTED_TOO_FAR)
    later = msgspec.structs.replace(estimate, t_ns=estimate.t_ns + 9 * S, north_m=estimate.north_m + 0.01)
    plan = controller.plan(later)
    assert (plan.health, plan.origin) == ("nominal", SOLVED)
    assert controller.plan(later, t_ns=later.t_ns + S).health == "degraded"


def test_in_hold_the_depth_at_which_it_began_is_kept():
    """The vehicle sinks for ten seconds after the last estimate: it goes neither back there nor on."""
    controller, estimate = flown(reference=references.Point(north_m=0.0, east_m=0.0, depth_m=50.0))
    plans = silent(controller, estimate, 20.0)
    last = estimate
    for plan in plans:
        last = advance(SURFACES, last, plan, duration_s=PERIOD_S)
        if plan.health == "degraded":
            began_m = last.depth_m
    assert began_m > estimate.depth_m + 1.0
    assert last.depth_m == pytest.approx(began_m, abs=0.3)


def test_no_reference_starts_at_an_estimate_of_long_ago():
    """Where the vehicle was nine seconds ago is no place to hold."""
    controller, estimate = flown()
    controller.follow(references.Hold(depth_m=10.0))
    waiting = controller.plan(estimate, t_ns=estimate.t_ns + 9 * S)
    assert (waiting.origin, waiting.why, waiting.reference_m) == (ZERO, "the reference has not started yet", None)
    back = msgspec.structs.replace(estimate, t_ns=estimate.t_ns + 10 * S, north_m=3.0)
    assert controller.plan(back).reference_m == (3.0, estimate.east_m)


# --- the inputs of the caller ----------------------------------------------------------------------------------------

LEAK = HealthState(Health.FAILSAFE, "leak")


@pytest.mark.parametrize("age_s", [0.0, 30.0])
def test_a_caller_s_failsafe_is_one_at_every_age_of_the_estimate(age_s):
    controller, estimate = flown()
    plan = controller.plan(estimate, t_ns=estimate.t_ns + round(age_s * S), health=LEAK)
    assert (plan.health, plan.origin, plan.thrust_N[-1, 2]) == ("failsafe", ZERO, -12.5)
    assert plan.why == plan.health_why == (OLD_ESTIMATES if age_s > 20.0 else "leak")


@pytest.mark.parametrize("lateral", [True, False])
def test_a_hold_gives_the_reason_of_the_one_who_caused_it(lateral):
    controller, estimate = flown(msgspec.structs.replace(AGED, lateral=lateral))
    plan = controller.plan(estimate, health=HealthState(Health.HOLD, "battery"))
    assert (plan.why, plan.health_why) == ("battery", "battery")
    assert plan.origin is (STOP if lateral else ZERO)


def test_in_a_cycle_that_raises_the_caller_s_health_counts():
    controller, estimate = flown()
    controller.add_report = None  # type: ignore[assignment, method-assign]
    plan = controller.plan(estimate, applied=object(), health=LEAK)  # type: ignore[arg-type]
    assert "TypeError" in plan.why
    assert (plan.health, plan.health_why) == LEAK


def test_before_the_first_plausible_estimate_plan_and_status_agree():
    controller = Controller(SURFACES, POINT)
    assert controller.health(0).health == "degraded"
    plan = controller.plan(msgspec.structs.replace(Estimate.at_rest(), north_m=math.nan), t_ns=S)
    assert controller.health(S) == (plan.health, plan.health_why)
    assert plan.health == "failsafe"
    controller.plan(Estimate.at_rest(depth_m=5.0))
    assert controller.health(0) == NOMINAL


def test_a_stamp_ahead_is_never_predicted_back():
    """Up to 1 s ahead its plan is followed; from beyond the thrusters rest now and not when that time has come."""
    controller, estimate = flown()
    near = controller.plan(estimate, t_ns=estimate.t_ns - S)
    far = controller.plan(estimate, t_ns=estimate.t_ns - 30 * S)
    assert (near.health, near.origin) == ("degraded", SOLVED)
    assert (far.health, far.origin) == ("failsafe", ZERO)
    assert far.t_ns[0] < estimate.t_ns - 29 * S
