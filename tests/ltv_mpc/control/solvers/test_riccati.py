"""The QP along its stages: the exact optimum, whatever is active and wherever it begins."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from ltv_mpc.control.config import ResolvedConfig, Weights
from ltv_mpc.control.linearisation import Linearisation
from ltv_mpc.control.ocp.problem import optimality_error
from ltv_mpc.control.solvers import SOLVERS, osqp, riccati
from ltv_mpc.control.solvers.active_set import CONVERGED
from ltv_mpc.control.solvers.interface import Result
from ltv_mpc.control.solvers.interior_point import MAX_OPTIMALITY_ERROR
from ltv_mpc.control.solvers.sweep import Sweep
from ltv_mpc.messages import Array, Solve, SolveStatus
from tests.ltv_mpc.control.problems import LIMITS, LOWERED, Form, answer, equidistant, motion, unlike_any_motion

CONFIG = ResolvedConfig(horizon_s=5.1, weights=Weights())
FORM = Form(CONFIG.knots)
EXACT_N = 2e-3
"""``OFF`` is six tenths of it."""


class Alone:
    """The Riccati method without OSQP."""

    def __init__(self, config):
        self.knots, self.duals = config.knots, None

    def solve(self, problem, shift, *, last=True):  # noqa: ARG002
        if self.duals is None:
            self.duals, self.work = np.zeros(problem.low.shape), Sweep.empty(problem)
        outcome, sweeps = riccati.solve(problem, self.work, self.knots, shift, self.duals)
        exact = optimality_error(problem, self.work.z, self.duals) <= MAX_OPTIMALITY_ERROR
        status = SolveStatus.SOLVED if outcome == CONVERGED and exact else SolveStatus.FAILED
        return Result(self.work.z.copy(), Solve(status=status, iterations=sweeps))


@pytest.mark.parametrize("limits", [LIMITS, LOWERED], ids=["box", "lowered box"])
@pytest.mark.parametrize("stages", [1, 2, 17, 34])
@pytest.mark.parametrize("problem", [motion, unlike_any_motion])
def test_its_commands_are_the_optimum(problem, stages, limits):
    solver = Alone(msgspec.structs.replace(CONFIG, horizon_s=0.3 * stages, period_s=0.3))
    form, sweeps = Form(equidistant(stages), limits), []
    for seed in range(5):
        lin, target = problem(seed, stages)
        ours = answer(solver, form, lin, target)
        assert ours.solve.status is SolveStatus.SOLVED
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
    lin, target, rows = wall_seen_twice(seed, 34)
    ours = answer(Alone(config), Form(equidistant(34)), lin, target, rows=rows)
    assert ours.solve.status is SolveStatus.SOLVED, ours.solve.why
    assert ours.solve.iterations < 40  # 54 to 59 with the regularisations in the other order


def test_in_a_closed_loop_the_last_cycle_s_active_limits_mostly_hold(cycles, optima):
    solver = Alone(CONFIG)
    warm, cold = [], []
    for cycle, exact in zip(cycles, optima, strict=True):
        ours = answer(solver, FORM, cycle.lin, cycle.target, cycle.stages)
        assert ours.solve.status is SolveStatus.SOLVED
        np.testing.assert_allclose(ours.commands, exact, atol=EXACT_N)
        warm.append(ours.solve.iterations)
        cold.append(answer(Alone(CONFIG), FORM, cycle.lin, cycle.target).solve.iterations)
    assert np.median(warm) == 1
    assert sum(warm) < 0.9 * sum(cold)


def test_a_result_that_violates_the_conditions_is_handed_to_osqp(monkeypatch):
    solver, (lin, target) = SOLVERS["riccati"](CONFIG), motion(2, CONFIG.stages)
    for _ in range(2):  # the first one sets up OSQP
        by_sweeps = answer(solver, FORM, lin, target)
    monkeypatch.setattr(osqp, "MAX_OPTIMALITY_ERROR", 0.0)  # less than rounding
    by_osqp = answer(solver, FORM, lin, target)
    assert by_osqp.solve.iterations < by_sweeps.solve.iterations
    np.testing.assert_allclose(by_osqp.commands, by_sweeps.commands, atol=EXACT_N)


def test_osqp_is_set_up_with_the_first_problem_and_asked_no_more():
    solver, (lin, target) = SOLVERS["riccati"](CONFIG), motion(2, CONFIG.stages)
    answer(solver, FORM, lin, target)
    solver._solver = "to be asked would raise"
    ours = answer(solver, FORM, lin, target)
    np.testing.assert_array_equal(ours.commands, answer(Alone(CONFIG), FORM, lin, target).commands)
