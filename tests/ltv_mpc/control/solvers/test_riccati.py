"""The QP along its stages: the exact optimum, whatever is active and wherever it begins."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from ltv_mpc.control.config import ResolvedConfig, Weights
from ltv_mpc.control.linearisation import Linearisation
from ltv_mpc.control.solvers import active_set, interior_point, riccati
from ltv_mpc.control.solvers.osqp import OsqpSolver
from ltv_mpc.control.solvers.riccati import RiccatiSolver
from ltv_mpc.messages import Array, SolveStatus
from tests.ltv_mpc.control.problems import LIMITS, LOWERED, Form, answer, equidistant, motion, solved, unlike_any_motion

CONFIG = ResolvedConfig(horizon_s=5.1, weights=Weights())
FORM = Form(CONFIG.knots)
EXACT_N = 2e-3
"""``OFF`` is six tenths of it."""


@pytest.mark.parametrize("limits", [LIMITS, LOWERED], ids=["box", "lowered box"])
@pytest.mark.parametrize("stages", [1, 2, 17, 34])
@pytest.mark.parametrize("problem", [motion, unlike_any_motion])
def test_its_commands_are_the_optimum(problem, stages, limits):
    solver = RiccatiSolver(msgspec.structs.replace(CONFIG, horizon_s=0.3 * stages, period_s=0.3))
    form, sweeps = Form(equidistant(stages), limits), []
    for seed in range(5):
        lin, target = problem(seed, stages)
        ours = answer(solver, form, lin, target)
        assert ours.solve.status is SolveStatus.SOLVED
        assert ours.solve.primal_residual <= 1.01 * active_set.HELD_ROW_TOLERANCE
        np.testing.assert_array_equal(ours.commands[0], lin.U[0])
        np.testing.assert_allclose(ours.commands, form.optimum(lin, target), atol=EXACT_N)
        sweeps.append(ours.solve.iterations)
    if stages >= 17 and problem is motion:
        assert max(sweeps) > riccati.FIRST_SWEEPS, "none of these took the interior point"
    assert max(sweeps) <= riccati.MAX_SWEEPS


def wall_seen_twice(seed: int, stages: int) -> tuple[Linearisation, Array, Array]:
    """Return a problem with a target behind a wall that is two half-planes at almost the same angle, and a third one.

    The third is the opposite wall, in front of the first or behind it.
    """
    lin, target = motion(seed, stages)
    rng, rows = np.random.default_rng(1000 + seed), np.zeros((stages, 3, 4))
    ahead, origin = rng.uniform(0.0, 2.0 * math.pi), lin.X[0, :2]
    towards = np.array([math.cos(ahead), math.sin(ahead)])
    target[:stages] = origin + towards * rng.uniform(5.0, 40.0)
    room_m = rng.uniform(-0.5, 0.5)
    for j, (turned, side) in enumerate(((0.0, -1.0), (rng.uniform(1e-4, 3e-2), -1.0), (rng.uniform(0.0, 3e-2), 1.0))):
        normal = side * np.array([math.cos(ahead + turned), math.sin(ahead + turned)])
        wall = normal @ (origin + towards * (0.3 if side < 0.0 else 0.3 - room_m))
        rows[:, j, :2], rows[:, j, 2], rows[:, j, 3] = (
            normal,
            wall - lin.X[1:, :2] @ normal,
            10 ** rng.uniform(3.0, 4.5),
        )
    return lin, target, rows


@pytest.mark.parametrize("seed", [11, 54, 228])
def test_half_planes_at_almost_the_same_angle_are_solved(seed):
    """Their duals still change when all products of slack and dual are nearly zero, the longer the more regularised."""
    config = msgspec.structs.replace(CONFIG, horizon_s=10.2)
    ours = solved(RiccatiSolver(config), Form(equidistant(34)), *wall_seen_twice(seed, 34))
    assert ours.solve.status is SolveStatus.SOLVED, ours.solve.why
    assert ours.solve.iterations < 40  # 54 to 59 with the regularisations in the other order


def test_in_a_closed_loop_the_last_cycle_s_active_limits_mostly_hold(cycles):
    solver = RiccatiSolver(CONFIG)
    warm, cold = [], []
    for cycle in cycles:
        ours = answer(solver, FORM, cycle.lin, cycle.target, cycle.stages)
        assert ours.solve.status is SolveStatus.SOLVED
        exact = FORM.optimum(cycle.lin, cycle.target)
        np.testing.assert_allclose(ours.commands, exact, atol=EXACT_N)
        warm.append(ours.solve.iterations)
        cold.append(answer(RiccatiSolver(CONFIG), FORM, cycle.lin, cycle.target).solve.iterations)
    assert np.median(warm) == 1
    assert sum(warm) < 0.9 * sum(cold)


def test_from_the_rows_of_a_similar_problem_the_interior_point_is_seldom_needed():
    """Without the line search, sets of rows come again and again, and it is needed nine times out of twelve."""
    sweeps = []
    for seed in range(12):
        lin, target = motion(seed, CONFIG.stages)
        solver = RiccatiSolver(CONFIG)
        answer(solver, FORM, lin, target)
        ours = answer(solver, FORM, lin, target + 0.05, 0.0)
        np.testing.assert_allclose(ours.commands, FORM.optimum(lin, target + 0.05), atol=EXACT_N)
        sweeps.append(ours.solve.iterations)
    assert np.count_nonzero(np.array(sweeps) > riccati.FIRST_SWEEPS) <= 2


def test_the_iteration_limit_ends_it_and_its_commands_are_still_usable():
    config = msgspec.structs.replace(CONFIG, max_iterations=9)
    solver = RiccatiSolver(config)
    lin, target = motion(1, CONFIG.stages)
    ours = answer(solver, FORM, lin, target)
    assert ours.solve.status is SolveStatus.ITERATION_LIMIT
    assert 9 <= ours.solve.iterations <= 9 + interior_point.LATER_SWEEPS
    assert f"{ours.solve.iterations} Riccati sweeps" in ours.solve.why
    assert ours.solve.dual_residual > interior_point.MAX_OPTIMALITY_ERROR
    assert 0.0 < ours.solve.primal_residual < 1.0


def test_a_result_that_violates_the_conditions_is_not_used():
    class Strict(RiccatiSolver):
        max_error = 0.0  # less than rounding

    solver = Strict(CONFIG, OsqpSolver(CONFIG))
    lin, target = motion(2, CONFIG.stages)
    assert answer(solver, FORM, lin, target).solve.status is SolveStatus.SOLVED
    alone = answer(Strict(CONFIG), FORM, lin, target).solve
    assert alone.status is SolveStatus.ITERATION_LIMIT
    assert "optimality error" in alone.why


def test_the_other_solver_is_set_up_with_the_first_problem_and_asked_no_more():
    class Counting(OsqpSolver):
        solves = 0

        def solve(self):
            self.solves += 1
            return super().solve()

    other = Counting(CONFIG)
    solver = RiccatiSolver(CONFIG, other)
    lin, target = motion(2, CONFIG.stages)
    for _ in range(3):
        ours = answer(solver, FORM, lin, target)
        np.testing.assert_array_equal(ours.commands, answer(RiccatiSolver(CONFIG), FORM, lin, target).commands)
    assert other.solves == 1


def test_a_cost_that_does_not_determine_the_commands_is_rejected():
    flat = Weights(thrust=0.0, thrust_change=0.0, terminal_position_per_m2=0.0, terminal_velocity_s2_per_m2=0.0)
    lin, target = motion(2, 5)
    lin.B1[...] = 0.0
    solve = answer(
        RiccatiSolver(msgspec.structs.replace(CONFIG, weights=flat, horizon_s=1.5)),
        Form(equidistant(5), LIMITS, flat),
        lin,
        target,
    ).solve
    assert solve.status is SolveStatus.FAILED
    assert "does not determine" in solve.why
