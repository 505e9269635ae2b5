"""Controller: its plans in closed loop, from hard starts, and when the solver fails; the depth law."""

from __future__ import annotations

from itertools import pairwise

import msgspec
import numpy as np
import pytest

from ltv_mpc import Controller, ControllerConfig, Estimate, PlanOrigin, Vehicle, advance, references
from ltv_mpc.control.config import Weights
from ltv_mpc.control.mode import NO_DEPTH
from ltv_mpc.control.problem_data import Constants
from ltv_mpc.control.resolution import settled
from ltv_mpc.control.vertical import VerticalPlan, follow_depth
from ltv_mpc.messages import Health
from ltv_mpc.safety.plan_gate import TOLERANCE_N
from tests.ltv_mpc.control.flights import descend, fly, rough_current

PAPER = Vehicle.load("paper")
POINT = references.Point(north_m=0.0, east_m=0.0)


def distance(estimate: Estimate) -> float:
    return float(np.hypot(estimate.north_m, estimate.east_m))


def test_a_horizon_is_whole_stages_of_0_3_s():
    assert [settled(ControllerConfig(horizon_s=h), PAPER).stages for h in (0.3, 2.5, 5.0, 10.0)] == [1, 8, 17, 33]
    plan = Controller(PAPER, POINT, ControllerConfig(horizon_s=5.0)).plan(Estimate.at_rest(north_m=1.0))
    assert plan.thrust_N.shape == (18, 3)
    assert plan.states.shape == (18, 6)
    np.testing.assert_array_equal(np.diff(plan.t_ns), 300_000_000)


def test_plans_join_without_a_jump_and_stay_inside_box_and_slew():
    _, plans = descend(7, 60, north_m=3.0, heading_rad=2.5)
    limits = np.array([[t.min_N, t.max_N, t.slew_N_per_s] for t in PAPER.thrusters])
    for before, after in pairwise(plans):
        np.testing.assert_allclose(after.thrust_N[0], before.thrust_at(int(after.t_ns[0])), atol=1e-9)
    for plan in plans:
        assert (plan.thrust_N >= limits[:, 0]).all()
        assert (plan.thrust_N <= limits[:, 1]).all()
        seconds = np.diff(plan.t_ns)[:, None] * 1e-9
        assert (np.abs(np.diff(plan.thrust_N, axis=0)) <= limits[:, 2] * seconds + TOLERANCE_N).all()


def test_the_plan_s_states_are_what_the_vehicle_then_does():
    estimate = msgspec.structs.replace(Estimate.at_rest(north_m=1.0, depth_m=5.0), current=rough_current(3))
    controller = Controller(PAPER, references.Point(north_m=0.0, east_m=0.0, depth_m=30.0))
    estimate = fly(controller, estimate, 5)[0][-1]
    plan = controller.plan(estimate)
    start_s = (int(plan.t_ns[0]) - estimate.t_ns) * 1e-9
    for knot in (0, 5, 17):
        there = advance(PAPER, estimate, plan, duration_s=start_s + 0.3 * knot)
        np.testing.assert_allclose(plan.states[knot, :2], [there.north_m, there.east_m], atol=2e-3)


def test_the_descent_holds_the_line():
    held, _ = descend(5, 150)
    assert np.mean([distance(e) for e in held[20:]]) < 0.05


def test_from_metres_off_with_a_wrong_heading_it_returns_and_stays():
    way, _ = fly(Controller(PAPER, POINT), Estimate.at_rest(north_m=5.0, heading_rad=-1.57), 240)
    assert distance(way[-1]) < 0.1


def test_delay_is_compensated():
    """With plans that take effect 0.7 s later the error stays near that without delay."""

    def mean_error(delay_s: float) -> float:
        config = ControllerConfig(first_delay_s=delay_s)
        estimates, _ = descend(12, 150, config)
        return float(np.mean([distance(e) for e in estimates[30:]]))

    assert mean_error(0.71) < 1.3 * mean_error(0.0)


def test_a_plan_starts_one_expected_delay_after_now():
    controller = Controller(PAPER, POINT, ControllerConfig(first_delay_s=0.4))
    plan = controller.plan(Estimate.at_rest(), t_ns=250_000_000)
    assert plan.cycle_t_ns == 250_000_000
    assert plan.t_ns[0] == 650_000_000
    assert plan.expected_delay_ns == 400_000_000


def test_a_hold_drives_no_thruster_before_its_start_and_then_holds_its_position():
    controller = Controller(PAPER, references.Hold(start_s=0.0, depth_m=10.0))
    before = controller.plan(msgspec.structs.replace(Estimate.at_rest(north_m=4.0, depth_m=0.0), t_ns=-500_000_000))
    assert before.origin is PlanOrigin.ZERO
    assert before.reference_m is None
    assert not before.thrust_N.any()
    later = msgspec.structs.replace(Estimate.at_rest(north_m=4.02, east_m=1.0, depth_m=0.01), t_ns=200_000_000)
    after = controller.plan(msgspec.structs.replace(later, velocity_north_mps=0.1, velocity_down_mps=0.05))
    assert after.reference_m == pytest.approx((4.0, 1.0))  # extrapolated back to the start
    assert after.thrust_N[-1, 2] > 30.0


# --- depth -----------------------------------------------------------------------------------------------------------


def test_it_ramps_to_a_depth_and_holds_it():
    reference = references.Point(north_m=0, east_m=0, depth_m=8.0, descent_rate_mps=0.15)
    controller = Controller(PAPER, reference, ControllerConfig(lateral=False))
    way, _ = fly(controller, Estimate.at_rest(depth_m=0.0), 400)
    assert way[100].depth_m == pytest.approx(0.15 * 30.3, abs=0.35)
    assert max(e.depth_m for e in way) < 8.3
    assert way[-1].depth_m == pytest.approx(8.0, abs=0.02)


def test_on_a_ramp_that_is_too_fast_the_thruster_saturates_without_windup():
    numbers = Constants.of(PAPER, Weights(), np.arange(18.0))
    at, free = np.array([1.0, 0.2, 62.5, 62.5, 0.0]), np.array([-np.inf, np.inf, 0.3])
    plan = VerticalPlan(*follow_depth(numbers, at, np.full(18, 9.0), np.full(18, 0.3), free))
    np.testing.assert_array_equal(plan.thrust_N, 62.5)
    assert plan.integral_rate_N_per_s == 0.0


def test_without_an_estimated_depth_there_is_no_vertical_thrust():
    """Without feedback the thruster would go to its limit and stay there."""
    controller = Controller(PAPER, references.Point(north_m=0.0, east_m=0.0, depth_m=30.0))
    for k in range(5):
        plan = controller.plan(msgspec.structs.replace(Estimate.at_rest(north_m=0.5), t_ns=k * 300_000_000))
        assert not plan.thrust_N[:, 2].any()
        assert (plan.origin, plan.why) == (PlanOrigin.SOLVED, NO_DEPTH)
        assert (plan.health, plan.health_why) == (Health.DEGRADED, NO_DEPTH)
    plan = controller.plan(msgspec.structs.replace(Estimate.at_rest(depth_m=1.0), t_ns=5 * 300_000_000))
    assert (plan.why, plan.health) == ("", Health.NOMINAL)


@pytest.mark.parametrize(
    ("name", "reference"),
    [
        ("paper", references.Point(north_m=0.0, east_m=0.0)),
        ("paper", references.Point(north_m=0.0, east_m=0.0, depth_m=3.0, start_s=9.0)),
        ("surface", references.Point(north_m=0.0, east_m=0.0, depth_m=3.0)),
    ],
)
def test_a_depth_is_missing_only_where_it_is_needed(name, reference):
    """A surface craft follows a reference with a depth on the surface (docs/vehicles.md)."""
    plan = Controller(Vehicle.load(name), reference).plan(Estimate.at_rest(north_m=0.5))
    assert NO_DEPTH not in (plan.why, plan.health_why)
    if name == "surface":
        assert plan.origin is PlanOrigin.SOLVED
        assert not plan.thrust_N[:, 2].any()


@pytest.mark.parametrize("period_s", [0.1, 0.7])
def test_the_integral_grows_with_time_not_with_the_number_of_cycles(period_s):
    """M_z w0^2 / T_i e = 225 x 0.09 / 20 x 0.05 = 0.0506 N/s at an error of 5 cm."""
    controller = Controller(PAPER, references.Point(north_m=0.0, east_m=0.0, depth_m=10.05, descent_rate_mps=5.0))
    still = Estimate.at_rest(depth_m=10.0)
    for t_s in np.arange(0.0, 7.0 + 1e-9, period_s):
        controller.plan(msgspec.structs.replace(still, t_ns=round(t_s * 1e9)))
    assert controller.save(7_000_000_000).depth_integral_N == pytest.approx(0.0506 * 7.0, rel=0.1)
