"""What a cycle does when something fails: the next rung, in the same cycle, inside box and slew."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from ltv_mpc import Controller, ControllerConfig, Estimate, Plan, PlanOrigin, SolveStatus, Vehicle, advance, references
from ltv_mpc.control import controller as module
from ltv_mpc.control import line_search, nominal_trajectory
from ltv_mpc.messages import Health, Solve
from ltv_mpc.safety.health import Ages
from ltv_mpc.safety.plan_gate import PlanGate, PlanVerdict

SURFACES = msgspec.structs.replace(Vehicle.load("paper"), failsafe_vertical_N=-12.5)
POINT = references.Point(north_m=0.0, east_m=0.0, depth_m=10.0)
PERIOD_NS = 300_000_000
S = 1_000_000_000
SOLVED, SHIFTED, ZERO = PlanOrigin.SOLVED, PlanOrigin.SHIFTED, PlanOrigin.ZERO
HALF = np.array(62.5)
"""Largest thrust."""


def moving(t_ns: int = 0) -> Estimate:
    start = Estimate.at_rest(north_m=1.0, heading_rad=2.0, depth_m=5.0)
    return msgspec.structs.replace(start, t_ns=t_ns, velocity_north_mps=0.15, yaw_rate_radps=0.1)


def fly(controller: Controller, estimate: Estimate, cycles: int) -> tuple[Estimate, Plan]:
    for _ in range(cycles):
        plan = controller.plan(estimate)
        estimate = advance(SURFACES, estimate, plan, duration_s=0.3)
    return estimate, plan


def check(plan: Plan, before: Plan | None = None) -> None:
    """Finite, and accepted by the gate; it begins where the one before is."""
    assert np.isfinite(plan.thrust_N).all()
    assert np.isfinite(plan.states).all()
    assert PlanGate(SURFACES).offer(plan, 1, 0, int(plan.t_ns[0])) is PlanVerdict.ACCEPTED
    if before is not None:
        np.testing.assert_allclose(plan.thrust_N[0], before.thrust_at(int(plan.t_ns[0])), atol=1e-6)


class Solver:
    """One that answers as the real one does, or in another way."""

    def __init__(self, real) -> None:
        self.real, self.way = real, ""

    def __getattr__(self, name):
        return getattr(self.real, name)

    def solve(self):
        answer = self.real.solve()
        match self.way:
            case "nan":
                return answer._replace(commands=answer.commands + np.nan)
            case "raises":
                raise np.linalg.LinAlgError("as asked")
            case "residual":
                status = SolveStatus.ITERATION_LIMIT
                return answer._replace(solve=Solve(status=status, primal_residual=2.0, why="as asked"))
            case "infeasible":
                return answer._replace(solve=Solve(status=SolveStatus.INFEASIBLE, why="as asked"))
        return answer


def broken(monkeypatch, controller: Controller, way: str) -> None:
    """From now on each solver that the controller has or makes answers so."""
    make = module.make

    def made(vehicle, config):
        solver = Solver(make(vehicle, config))
        solver.way = way
        return solver

    monkeypatch.setattr(module, "make", made)
    controller._solver = made(controller.vehicle, controller.config)


@pytest.mark.parametrize(
    ("way", "why"),
    [
        ("nan", "not finite"),
        ("raises", "LinAlgError: as asked"),
        ("residual", "as asked"),
        ("infeasible", "as asked"),
    ],
)
def test_fallback_goes_from_solved_to_shifted_to_zero_and_back_to_solved(monkeypatch, way, why):
    controller = Controller(SURFACES, POINT)
    estimate, good = fly(controller, moving(), 5)
    assert good.origin is SOLVED
    real = module.make
    broken(monkeypatch, controller, way)
    origins, before = [], good
    for _ in range(24):
        plan = controller.plan(estimate)
        check(plan, before)
        assert why in plan.why
        origins.append(plan.origin)
        if plan.origin is SHIFTED:  # the solved plan up to its end
            inside = plan.t_ns <= good.t_ns[-1]
            for t, thrust in zip(plan.t_ns[inside], plan.thrust_N[inside], strict=True):
                np.testing.assert_allclose(thrust[:2], good.thrust_at(int(t))[:2], atol=1e-6)
        estimate, before = advance(SURFACES, estimate, plan, duration_s=0.3), plan
    # 17 stages, of which the plan solved last has 16 before it when the next one begins
    assert origins == [SHIFTED] * 16 + [ZERO] * 8
    np.testing.assert_array_equal(plan.thrust_N[-1, :2], [0.0, 0.0])
    monkeypatch.setattr(module, "make", real)
    recovered = controller.plan(estimate)
    assert recovered.origin is SOLVED
    check(recovered, before)


def test_beyond_the_end_of_the_solved_plan_a_shifted_one_takes_the_thrusts_to_zero(monkeypatch):
    controller = Controller(SURFACES, POINT)
    estimate, _ = fly(controller, moving(), 5)
    broken(monkeypatch, controller, "infeasible")
    for _ in range(15):
        plan = controller.plan(estimate)
        estimate = advance(SURFACES, estimate, plan, duration_s=0.3)
    assert plan.origin is SHIFTED
    np.testing.assert_array_equal(plan.thrust_N[-1, :2], [0.0, 0.0])


def test_a_long_plan_is_not_followed_blindly_for_longer_than_ten_seconds(monkeypatch):
    controller = Controller(SURFACES, POINT, ControllerConfig(horizon_s=30.0))
    estimate, _ = fly(controller, moving(), 3)
    broken(monkeypatch, controller, "infeasible")
    origins = []
    for _ in range(36):
        plan = controller.plan(estimate)
        origins.append(plan.origin)
        estimate = advance(SURFACES, estimate, plan, duration_s=0.3)
    assert origins.count(SHIFTED) == 33  # 10 s in cycles of 0.3 s
    assert origins[-1] is ZERO


def test_a_motion_that_nobody_can_foresee_ends_in_thrusts_of_zero(monkeypatch):
    """A shifted plan that is not finite is left for the next rung; the vertical thruster's law goes on."""
    controller = Controller(SURFACES, POINT)
    estimate, before = fly(controller, moving(), 20)
    broken(monkeypatch, controller, "infeasible")
    monkeypatch.setattr(
        nominal_trajectory, "shifted_trajectory", lambda _numbers, _start, _old, _stages, _C, _X, U: U.fill(math.nan)
    )
    plan = controller.plan(estimate)
    check(plan, before)
    assert (plan.origin, plan.why) == (ZERO, "as asked")
    np.testing.assert_array_equal(plan.thrust_N[-1, :2], [0.0, 0.0])


# --- whatever raises -------------------------------------------------------------------------------------------------

STAGES = (
    ("_prediction", "state_at"),
    ("_follower", "begin"),
    ("_follower", "advance"),
    ("_follower", "fill"),
    ("_commands", "add"),
    ("_commands", "at"),
    ("estimate_gate", "check"),
    ("_solver", "build"),
    ("_solver", "update"),
    ("_solver", "problem"),
)


@pytest.mark.parametrize(("part", "method"), STAGES)
def test_whatever_raises_the_same_cycle_has_a_plan_and_the_next_good_one_is_solved(part, method):
    controller = Controller(SURFACES, POINT)
    estimate, before = fly(controller, moving(), 5)

    def raises(*_, **__):
        raise MemoryError("as asked")

    with pytest.MonkeyPatch.context() as patch:
        if (part, method) == ("_solver", "problem"):  # asked for after a failure only
            broken(patch, controller, "infeasible")
        patch.setattr(getattr(controller, part), method, raises)
        plan = controller.plan(estimate)
        check(plan, None if method == "at" else before)
        if plan.origin is not SOLVED and method != "problem":
            assert "as asked" in plan.why
    estimate = advance(SURFACES, estimate, plan, duration_s=0.3)
    after = controller.plan(estimate)
    assert after.origin is SOLVED
    check(after, None if method == "add" else plan)  # what was sent is then known from the actuators alone


@pytest.mark.parametrize("method", ["choose_nominal", "line_search", "shifted_trajectory"])
def test_compiled_code_that_raises_costs_one_fallback_level(method):
    controller = Controller(SURFACES, POINT)
    estimate, before = fly(controller, moving(), 5)

    def raises(*_):
        raise FloatingPointError("as asked")

    with pytest.MonkeyPatch.context() as patch:
        if method == "shifted_trajectory":
            broken(patch, controller, "infeasible")
        patch.setattr(line_search if method == "line_search" else nominal_trajectory, method, raises)
        plan = controller.plan(estimate)
        check(plan, before)
        assert plan.origin in (SHIFTED, ZERO)
    assert controller.plan(advance(SURFACES, estimate, plan, duration_s=0.3)).origin is SOLVED


# --- a solver that saw rubbish ---------------------------------------------------------------------------------------

SOLVERS = ["osqp", "riccati", "piqp", "daqp"]


@pytest.mark.parametrize("solver", SOLVERS)
def test_after_rubbish_in_its_problem_a_solver_is_good_again_one_cycle_later(solver):
    """NaN past every guard of ours, into the numbers of the QP itself, three cycles long."""
    config = ControllerConfig(solver=solver)
    controller, spared = (Controller(SURFACES, POINT, config) for _ in range(2))
    estimate, _ = fly(controller, moving(), 4)
    begin = nominal_trajectory.choose_nominal

    def rubbish(numbers, start, target, commands, stages, flat):
        kind = begin(numbers, start, target, commands, stages, flat)
        flat[-5:] = np.nan
        return kind

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(nominal_trajectory, "choose_nominal", rubbish)
        for k in range(3):
            plan = controller.plan(estimate, t_ns=estimate.t_ns + k)
            check(plan)
            assert plan.origin is SHIFTED
            assert plan.solve.status in (SolveStatus.NON_FINITE, SolveStatus.FAILED)
    spared.restore(controller.save(estimate.t_ns), estimate.t_ns)  # but for its solver, which has seen nothing
    spared.estimate_gate.check(estimate)
    after, theirs = (each.plan(estimate, t_ns=estimate.t_ns + 3) for each in (controller, spared))
    assert after.origin is theirs.origin is SOLVED
    np.testing.assert_allclose(after.thrust_N, theirs.thrust_N, atol=0.05)


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_solver_that_failed_is_made_anew(solver):
    controller = Controller(SURFACES, POINT, ControllerConfig(solver=solver))
    estimate, _ = fly(controller, moving(), 2)
    with pytest.MonkeyPatch.context() as patch:
        broken(patch, controller, "raises")
        failing = controller._solver
        controller.plan(estimate)
    assert controller.plan(estimate, t_ns=estimate.t_ns + PERIOD_NS).origin is SOLVED
    assert controller._solver is not failing


# --- estimates that are no estimates, or old -------------------------------------------------------------------------

BAD = [
    {"north_m": math.nan},
    {"heading_rad": math.inf},
    {"velocity_east_mps": -math.inf},
    {"yaw_rate_radps": math.nan},
    {"depth_m": math.nan},
    {"velocity_north_mps": 40.0},
    {"yaw_rate_radps": 30.0},
    {"north_m": 5000.0},
    {"velocity_down_mps": 50.0},
]


@pytest.mark.parametrize("bad", BAD)
def test_an_invalid_estimate_is_replaced_by_the_last_one_for_one_cycle(bad):
    controller = Controller(SURFACES, POINT)
    estimate, before = fly(controller, moving(), 5)
    for _ in range(3):
        plan = controller.plan(msgspec.structs.replace(estimate, **bad))
        check(plan, before)
        assert plan.origin is SOLVED
        assert plan.estimate_t_ns < estimate.t_ns
        estimate, before = advance(SURFACES, estimate, plan, duration_s=0.3), plan
        if "north_m" in bad:
            bad = {"north_m": -bad["north_m"]}
    assert sum(controller.estimate_gate.rejected.values()) == 3
    plan = controller.plan(estimate)
    assert plan.origin is SOLVED
    assert plan.estimate_t_ns == estimate.t_ns
    check(plan, before)


def test_who_has_never_said_anything_sound_is_not_driven_on():
    plan = Controller(SURFACES, POINT).plan(msgspec.structs.replace(moving(), north_m=math.nan))
    check(plan)
    assert (plan.origin, plan.health) == (ZERO, Health.FAILSAFE)
    assert plan.why == "no valid estimate: a number is not finite"
    np.testing.assert_allclose(plan.thrust_N[-1], [0.0, 0.0, -12.5])


@pytest.mark.parametrize(
    ("age_ms", "health", "origin"),
    [
        (0, "nominal", SOLVED),
        (500, "nominal", SOLVED),
        (501, "degraded", SOLVED),
        (1500, "degraded", SOLVED),
        (1501, "hold", ZERO),
        (3000, "hold", ZERO),
        (3001, "failsafe", ZERO),
        (3_600_000, "failsafe", ZERO),
    ],
)
def test_what_is_done_on_an_estimate_by_its_age(age_ms, health, origin):
    controller = Controller(SURFACES, POINT)
    for k in range(6):
        estimate = moving(k * 100_000_000)
        before = controller.plan(estimate)
    plan = controller.plan(estimate, t_ns=estimate.t_ns + age_ms * 1_000_000)
    check(plan)
    assert (plan.health, plan.origin) == (health, origin)
    if origin is ZERO:
        np.testing.assert_array_equal(plan.thrust_N[-1, :2], [0.0, 0.0])
        assert bool(plan.thrust_N[-1, 2] == -12.5) is (health == "failsafe")
        assert plan.why == f"the newest estimate is {age_ms / 1000:.1f} s old"
    assert before.origin is SOLVED


def test_in_hold_the_depth_is_kept_as_far_as_it_is_known():
    controller = Controller(SURFACES, references.Point(north_m=0.0, east_m=0.0, depth_m=50.0))
    estimate, before = fly(controller, msgspec.structs.replace(Estimate.at_rest(depth_m=0.0)), 60)
    assert estimate.velocity_down_mps > 0.1
    there = advance(SURFACES, estimate, before, duration_s=1.6)
    while there.t_ns <= estimate.t_ns + 2_800_000_000:
        plan = controller.plan(estimate, t_ns=there.t_ns)
        assert plan.origin is ZERO
        there = advance(SURFACES, there, plan, duration_s=0.3)
    # 0.2 m/s for 1.6 s takes it 0.3 m down; from there the law takes it back.
    end = advance(SURFACES, there, plan, duration_s=4.5)
    assert end.depth_m < there.depth_m
    assert end.depth_m == pytest.approx(estimate.depth_m, abs=0.25)


def test_a_slow_publisher_is_given_multiples_of_its_own_period():
    controller = Controller(SURFACES, POINT)
    for k in range(5):
        estimate = moving(k * S)
        controller.plan(estimate)
    ages = {age_s: controller.plan(estimate, t_ns=estimate.t_ns + round(age_s * S)) for age_s in (3.0, 4.0, 6.0, 6.1)}
    assert [(p.health, p.origin) for p in ages.values()] == [
        ("nominal", SOLVED), ("degraded", SOLVED), ("hold", ZERO), ("failsafe", ZERO)
    ]  # fmt: skip


def test_the_thresholds_are_settings():
    ages = Ages(degraded_s=0.1, hold_s=0.2, failsafe_s=0.4)
    controller = Controller(SURFACES, POINT, ControllerConfig(ages=ages))
    estimate = moving()
    healths = [controller.plan(estimate, t_ns=round(t * S)).health for t in (0.1, 0.15, 0.3, 0.5)]
    assert healths == ["nominal", "degraded", "hold", "failsafe"]


def test_the_caller_s_own_inputs_can_make_it_worse_but_not_better():
    controller = Controller(SURFACES, POINT)
    estimate = moving()
    assert controller.plan(estimate, health=Health.DEGRADED).health == "degraded"
    assert controller.plan(estimate, health=Health.HOLD).origin is ZERO
    assert controller.plan(estimate, t_ns=2 * S, health=Health.NOMINAL).health == "hold"


def test_a_reference_does_not_begin_on_an_old_estimate_or_move_while_held():
    waiting = Controller(SURFACES, references.Hold(depth_m=10.0))
    assert waiting.plan(moving(), t_ns=2 * S).why == "the reference has not started yet"
    controller = Controller(SURFACES, references.load("line"))
    estimate, _ = fly(controller, moving(), 20)
    before = controller.follower.save().tau_s
    for t_s in (1.6, 2.0, 2.4):
        controller.plan(estimate, t_ns=estimate.t_ns + round(t_s * S))
    assert controller.follower.save().tau_s == before
