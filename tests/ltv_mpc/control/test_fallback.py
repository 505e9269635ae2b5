"""Fallback levels: a cycle in which something fails takes the next level, inside box and slew."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from ltv_mpc import Controller, ControllerConfig, Estimate, Plan, PlanOrigin, SolveStatus, Vehicle, advance, references
from ltv_mpc.control import nominal
from ltv_mpc.control.prediction import Prediction, SentCommands
from ltv_mpc.control.solvers import make
from ltv_mpc.control.solvers.osqp import OsqpSolver
from ltv_mpc.control.solvers.recorder import QpRecorder, RecordingSolver
from ltv_mpc.control.solvers.sparse import SparseLayout
from ltv_mpc.geofence.fence import Disc, Fence
from ltv_mpc.messages import DisturbanceState, Health, Solve
from ltv_mpc.references.follower import Follower
from ltv_mpc.safety.estimate_gate import EstimateGate
from ltv_mpc.safety.plan_gate import PlanGate, PlanVerdict
from tests.ltv_mpc.control import flights
from tests.ltv_mpc.control.problems import SOLVER_NAMES

SURFACES = msgspec.structs.replace(Vehicle.load("paper"), failsafe_vertical_N=-12.5)
POINT = references.Point(north_m=0.0, east_m=0.0, depth_m=10.0)
PERIOD_NS = 300_000_000
S = 1_000_000_000
SOLVED, SHIFTED, STOP, ZERO = PlanOrigin.SOLVED, PlanOrigin.SHIFTED, PlanOrigin.STOP, PlanOrigin.ZERO


SPUN = np.array([-1.12, -0.95, 0.11, 0.75, 0.67, 1.0, -0.21, -0.28, 0.13, 0.91, -0.59, 0.05])
"""What a light boat with a reversed thruster has taught: its motion ends at no finite number."""


def moving(t_ns: int = 0) -> Estimate:
    start = Estimate.at_rest(north_m=1.0, heading_rad=2.0, depth_m=5.0)
    return msgspec.structs.replace(start, t_ns=t_ns, velocity_north_mps=0.15, yaw_rate_radps=0.1)


def fly(controller: Controller, estimate: Estimate, cycles: int) -> tuple[Estimate, Plan]:
    way, plans = flights.fly(controller, estimate, cycles, solved=False)
    return way[-1], plans[-1]


def origins_of(controller: Controller, estimate: Estimate, cycles: int) -> list[PlanOrigin]:
    return [plan.origin for plan in flights.fly(controller, estimate, cycles, solved=False)[1]]


def check(plan: Plan, before: Plan | None = None) -> None:
    """Check that a plan is finite, that the gate accepts it, and that it begins at the command in force."""
    assert np.isfinite(plan.thrust_N).all()
    assert np.isfinite(plan.states).all()
    assert PlanGate(SURFACES).offer(plan, 1, 0, int(plan.t_ns[0])) is PlanVerdict.ACCEPTED
    if before is not None:
        np.testing.assert_allclose(plan.thrust_N[0], before.thrust_at(int(plan.t_ns[0])), atol=1e-6)


class Faulty:
    """Solver factory whose solvers do as the real ones, until ``fault`` names another way."""

    def __init__(self) -> None:
        self.fault = ""
        self.solvers: list[FaultySolver] = []

    def __call__(self, vehicle, config):
        self.solvers.append(FaultySolver(make(vehicle, config), self))
        return self.solvers[-1]


class FaultySolver(RecordingSolver):
    """Solver with the fault of its factory."""

    def __init__(self, solver, factory: Faulty) -> None:
        super().__init__(solver)
        self.factory = factory

    def solve(self, *problem, last=True):
        result = super().solve(*problem, last=last)
        match self.factory.fault:
            case "nan":
                return result._replace(z=result.z + np.nan)
            case "raises":
                raise np.linalg.LinAlgError("as asked")
            case "residual":
                status = SolveStatus.ITERATION_LIMIT
                return result._replace(solve=Solve(status=status, primal_residual=2.0, why="as asked"))
            case "infeasible":
                return result._replace(solve=Solve(status=SolveStatus.INFEASIBLE, why="as asked"))
        return result


EQUAL_STAGES = ControllerConfig(horizon_s=5.1)
"""17 stages of 0.3 s: a plan that is shifted moves by one knot a cycle."""


def faulty(vehicle=SURFACES, reference=POINT, config: ControllerConfig = EQUAL_STAGES) -> tuple[Controller, Faulty]:
    """Return a controller, and the factory that breaks its solver."""
    factory = Faulty()
    return Controller(vehicle, reference, config, make_solver=factory), factory


@pytest.mark.parametrize(
    ("way", "why"),
    [
        ("nan", "not finite"),
        ("raises", "LinAlgError: as asked"),
        ("residual", "as asked"),
        ("infeasible", "as asked"),
    ],
)
def test_levels_follow_in_order_solved_shifted_zero_and_solved_again(way, why):
    controller, solver = faulty()
    estimate, good = fly(controller, moving(), 5)
    assert good.origin is SOLVED
    solver.fault = way
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
    solver.fault = ""
    recovered = controller.plan(estimate)
    assert recovered.origin is SOLVED
    check(recovered, before)


def test_without_a_previous_plan_a_failed_solve_keeps_a_resting_vehicle_at_rest():
    controller, solver = faulty(reference=references.Point(north_m=0.0, east_m=0.0))
    solver.fault = "infeasible"
    plan = controller.plan(Estimate.at_rest(north_m=1.0))
    assert (plan.origin, plan.why) == (ZERO, "as asked")
    assert not plan.thrust_N.any()


def test_a_long_plan_is_shifted_for_at_most_ten_seconds():
    controller, solver = faulty(config=ControllerConfig(horizon_s=30.0))
    estimate, _ = fly(controller, moving(), 3)
    solver.fault = "infeasible"
    origins = origins_of(controller, estimate, 36)
    assert origins.count(SHIFTED) == 33  # 10 s in cycles of 0.3 s
    assert origins[-1] is ZERO


def test_a_shifted_plan_with_a_motion_that_is_not_finite_gives_way_to_zero_thrust(monkeypatch):
    """The next level is taken; the depth law continues."""
    controller, solver = faulty()
    estimate, before = fly(controller, moving(), 20)
    solver.fault = "infeasible"
    ramp_to, errors = nominal.ramp_to, iter([0.0, math.nan])  # of the nominal trajectory, and of the shifted plan

    def not_finite_at_once(*args):
        ramp_to(*args)
        args[-1][:] += next(errors, 0.0)

    monkeypatch.setattr(nominal, "ramp_to", not_finite_at_once)
    plan = controller.plan(estimate)
    check(plan, before)
    assert (plan.origin, plan.why) == (ZERO, "as asked")
    np.testing.assert_array_equal(plan.thrust_N[-1, :2], [0.0, 0.0])


# --- a part that raises ----------------------------------------------------------------------------------------------

STAGES = (
    (Prediction, "state_at"),
    (Follower, "begin"),
    (Follower, "advance"),
    (SentCommands, "add"),
    (SentCommands, "at"),
    (EstimateGate, "check"),
    (OsqpSolver, "solve"),
    (SparseLayout, "qp"),
    *((nominal, name) for name in ("choose_nominal", "line_search", "ramp_to")),  # compiled
)


@pytest.mark.parametrize(("part", "method"), STAGES)
def test_a_cycle_in_which_a_part_raises_has_a_plan_and_the_next_one_is_solved(part, method):
    controller, solver = Controller(SURFACES, POINT), None
    if part is SparseLayout:  # built by the recorder of a failed QP
        solver = Faulty()
        controller = Controller(SURFACES, POINT, make_solver=QpRecorder(solver))
    estimate, before = fly(controller, moving(), 5)

    def raises(*_, **__):
        raise MemoryError("as asked")

    with pytest.MonkeyPatch.context() as patch:
        if solver is not None:
            solver.fault = "infeasible"
        patch.setattr(part, method, raises)
        plan = controller.plan(estimate)
        check(plan, None if method == "at" else before)
        if plan.origin is not SOLVED:  # a cycle that is solved does not need SentCommands.at
            assert "as asked" in plan.why
            assert plan.origin is SHIFTED or plan.health is Health.DEGRADED
        assert part is not nominal or plan.origin in (SHIFTED, ZERO)
    if solver is not None:
        solver.fault = ""
    estimate = advance(SURFACES, estimate, plan, duration_s=0.3)
    after = controller.plan(estimate)
    assert after.origin is SOLVED
    check(after, None if method == "add" else plan)  # what was sent is then known from the actuators alone


def test_a_failed_qp_with_a_fence_is_recorded_with_its_half_planes():
    wreck = Disc(name="wreck", centre=references.Place(north_m=2.5, east_m=0.0), radius_m=1.0)
    solver = Faulty()
    solver.fault = "infeasible"
    recorder = QpRecorder(solver)
    controller = Controller(SURFACES, POINT, make_solver=recorder)
    controller.set_fence(Fence(margin_m=0.1, keep_out_disc=(wreck,)))
    controller.plan(moving())
    assert recorder.failed is not None
    assert len(recorder.failed.rows) == len(recorder.failed.qp.l)
    assert "of the fence" in recorder.failed.rows[-1].name


# --- a solver that was given NaN -------------------------------------------------------------------------------------


@pytest.mark.parametrize("solver", SOLVER_NAMES)
def test_a_solver_recovers_one_cycle_after_a_problem_with_nan(solver):
    """NaN is put into the QP's numbers, past every check, for three cycles."""
    config = ControllerConfig(solver=solver)
    controller, unaffected = (Controller(SURFACES, POINT, config) for _ in range(2))
    estimate, _ = fly(controller, moving(), 4)
    begin = nominal.choose_nominal

    def with_nan(cycle, *others, **settings):
        chosen = begin(cycle, *others, **settings)
        cycle.lin.B1[-1, -3:] = np.nan
        return chosen

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(nominal, "choose_nominal", with_nan)
        for k in range(3):
            plan = controller.plan(estimate, t_ns=estimate.t_ns + k)
            check(plan)
            assert plan.origin is SHIFTED
            assert plan.solve.status in (SolveStatus.NON_FINITE, SolveStatus.FAILED)
    unaffected.restore(controller.save(estimate.t_ns), estimate.t_ns)  # its solver was given no NaN
    unaffected.estimate_gate.check(estimate)
    after, theirs = (each.plan(estimate, t_ns=estimate.t_ns + 3) for each in (controller, unaffected))
    assert after.origin is theirs.origin is SOLVED
    np.testing.assert_allclose(after.thrust_N, theirs.thrust_N, atol=0.05)


# --- implausible and old estimates -----------------------------------------------------------------------------------


def test_an_implausible_estimate_is_replaced_by_the_last_plausible_one():
    controller = Controller(SURFACES, POINT)
    estimate, before = fly(controller, moving(), 5)
    for _ in range(3):
        plan = controller.plan(msgspec.structs.replace(estimate, velocity_north_mps=40.0))
        check(plan, before)
        assert plan.origin is SOLVED
        assert plan.estimate_t_ns < estimate.t_ns
        estimate, before = advance(SURFACES, estimate, plan, duration_s=0.3), plan
    assert sum(controller.estimate_gate.rejected.values()) == 3
    plan = controller.plan(estimate)
    assert plan.origin is SOLVED
    assert plan.estimate_t_ns == estimate.t_ns
    check(plan, before)


def test_a_reference_does_not_advance_in_hold():
    controller = Controller(SURFACES, references.load("line"))
    estimate, _ = fly(controller, moving(), 20)
    before = controller.follower.save().tau_s
    for t_s in (11.0, 12.0, 19.0):
        controller.plan(estimate, t_ns=estimate.t_ns + round(t_s * S))
    assert controller.follower.save().tau_s == before


def test_from_a_shifted_plan_a_new_controller_shifts_no_longer_than_the_old_one():
    controller, solver = faulty()
    estimate, _ = fly(controller, moving(), 5)
    solver.fault = "infeasible"
    estimate, plan = fly(controller, estimate, 10)
    assert plan.origin is SHIFTED
    successor, broken = faulty()
    successor.restore(controller.save(estimate.t_ns), estimate.t_ns)
    broken.fault = "infeasible"
    origins = origins_of(successor, estimate, 12)
    # 16 cycles, of which the first controller had ten; the ramp at the end adds some
    assert origins[:6] == [SHIFTED] * 6
    assert origins[-2:] == [ZERO] * 2


def test_a_learned_vehicle_without_a_finite_motion_is_forgotten():
    controller = Controller(Vehicle.load("bluerobotics-boat"), references.Point(north_m=0.0, east_m=0.0))
    controller.observer.restore(DisturbanceState(mean=SPUN, covariance=1e-6 * np.eye(12)), 0)
    away = Estimate.at_rest(north_m=60.0, east_m=60.0, heading_rad=1.0)
    estimate = msgspec.structs.replace(away, yaw_rate_radps=0.3, velocity_north_mps=-1.0, velocity_east_mps=-1.0)
    plans = [controller.plan(estimate, t_ns=k * PERIOD_NS) for k in range(2)]
    assert [plan.origin for plan in plans] == [ZERO, SOLVED]
    assert [plan.health for plan in plans] == [Health.DEGRADED, Health.NOMINAL]
