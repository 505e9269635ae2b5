"""OSQP on the sparse QP: near the exact optimum in a closed loop, at it when asked to be precise."""

from __future__ import annotations

from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from ltv_mpc.control.config import ResolvedConfig, Weights
from ltv_mpc.control.solvers import osqp, riccati
from ltv_mpc.control.solvers.active_set import FAILED
from ltv_mpc.control.solvers.osqp import OsqpSolver
from ltv_mpc.control.solvers.sparse import residuals
from ltv_mpc.messages import SolveStatus
from tests.ltv_mpc.control.problems import LIMITS, LOWERED, Form, answer, equidistant, motion

CONFIG = ResolvedConfig(horizon_s=5.1, weights=Weights())
PRECISE = msgspec.structs.replace(CONFIG, tolerance=1e-12, max_iterations=6000)
"""Residuals end at 1e-6, which is rounding on rows scaled by 300."""
FORM = Form(CONFIG.knots)


@pytest.mark.parametrize("limits", [LIMITS, LOWERED], ids=["box", "lowered box"])
@pytest.mark.parametrize("stages", [1, 17, 34])
def test_its_commands_are_the_sparse_qp_s_optimum(stages, limits):
    config = msgspec.structs.replace(PRECISE, horizon_s=0.3 * stages, period_s=0.3)
    solver, form = OsqpSolver(config), Form(equidistant(stages), limits)
    for seed in range(3):
        lin, target = motion(seed, stages, gap=0.02)
        ours = answer(solver, form, lin, target)
        np.testing.assert_array_equal(ours.commands[0], lin.U[0])
        np.testing.assert_allclose(ours.commands, form.optimum(lin, target), atol=1e-3)


def test_the_first_free_knot_is_within_0_1_N_in_99_percent_of_a_closed_loop(cycles, optima):
    solver = OsqpSolver(CONFIG)
    off, iterations = [], []
    for cycle, exact in zip(cycles, optima, strict=True):
        ours = answer(solver, FORM, cycle.lin, cycle.target, cycle.stages)
        assert ours.solve.status is SolveStatus.SOLVED
        off.append(np.abs(ours.commands[1] - exact[1]).max())
        iterations.append(ours.solve.iterations)
    assert len(off) >= 200
    assert np.mean(np.array(off) <= 0.1) >= 0.99
    assert max(off) <= 1.0
    assert np.median(iterations) <= 6


@pytest.mark.parametrize("off_m", [10.0, 100.0])
def test_far_from_its_line_it_ends_as_soon(off_m):
    """Duals grow with the distance, and with them what rounding leaves of OSQP's own solution."""
    solver = OsqpSolver(CONFIG)
    for seed in range(8):
        lin, target = motion(seed, CONFIG.stages)
        target[:-1] += off_m
        ours = answer(solver, FORM, lin, target)
        assert ours.solve.status is SolveStatus.SOLVED
        assert ours.solve.iterations <= 10
        np.testing.assert_allclose(ours.commands, FORM.optimum(lin, target), atol=0.01)


def test_without_sweeps_osqp_starts_from_the_trajectory_and_the_last_duals():
    """A cost that does not say what the last command should be: no weight on thrust, no effect of the last one."""
    weights = Weights(thrust=0.0, thrust_change=0.0)
    solver = OsqpSolver(msgspec.structs.replace(PRECISE, weights=weights, horizon_s=1.5))
    form = Form(equidistant(5), LIMITS, weights)
    lin, target = motion(3, 5)
    lin.B1[-1] = 0.0
    moved = answer(solver, form, lin, target).commands - lin.U
    duals = solver.duals.copy()
    assert np.abs(moved).max() > 0.1
    assert np.abs(duals).max() > 0.0
    assert riccati.solve(form.problem(lin, target), solver.work, form.knots, 0.0, solver.duals)[0] == FAILED
    np.testing.assert_array_equal(solver.work.z[:-1, 10:], 0.0)
    np.testing.assert_allclose(solver.duals, duals, atol=osqp.NOT_ACTIVE)


def test_the_tolerance_is_on_the_residuals(cycles):
    precise = msgspec.structs.replace(CONFIG, tolerance=1e-6, max_iterations=5000)
    solver = OsqpSolver(precise)
    for cycle in cycles[::20]:
        answer(solver, FORM, cycle.lin, cycle.target)
        qp = solver.layout.qp(FORM.problem(cycle.lin, cycle.target))
        kkt = residuals(qp, solver.arrays.x, solver.arrays.y)
        # the tolerance grows with the gradient; the rows of free limits are scaled down, and so is their violation
        size = osqp.dual_scale(qp.q[: solver.layout.column.max() + 1])
        assert kkt.stationarity <= 1e-6 * size
        assert kkt.primal <= 1e-6 * size / osqp.LIMIT_ROW
        assert kkt.complementarity <= 1e-4


def test_a_solve_depends_on_its_problem_and_its_first_guess_alone(cycles):
    """Replay needs the same bits whatever was solved before."""
    used, fresh = OsqpSolver(CONFIG), OsqpSolver(CONFIG)
    for solver in (used, fresh):
        solver.set_up(FORM.problem(*motion(1, CONFIG.stages)))
    for cycle in cycles[150:160]:
        answer(used, FORM, cycle.lin, cycle.target)
    first = cycles[20]
    ours, theirs = (answer(s, FORM, first.lin, first.target) for s in (used, fresh))
    np.testing.assert_array_equal(ours.commands, theirs.commands)


def test_an_answer_that_is_not_finite_is_reported_and_the_workspace_rebuilt(cycles):
    class Poisoned:
        def __init__(self, real):
            self.real = real

        def __getattr__(self, name):
            return getattr(self.real, name)

        @property
        def solution(self):
            return SimpleNamespace(x=np.full_like(self.real.solution.x, np.nan), y=self.real.solution.y)

    solver, lin, target = OsqpSolver(CONFIG), cycles[30].lin, cycles[30].target
    good = answer(solver, FORM, lin, target)
    solver._solver = Poisoned(solver._solver)
    failed = answer(solver, FORM, lin, target)
    assert failed.solve.status is SolveStatus.NON_FINITE
    assert "rebuilt" in failed.solve.why
    np.testing.assert_array_equal(answer(solver, FORM, lin, target).commands, good.commands)


def test_the_iteration_limit_ends_a_solve_and_says_so(cycles):
    config = msgspec.structs.replace(CONFIG, tolerance=1e-14, max_iterations=20)
    solve = answer(OsqpSolver(config), FORM, cycles[150].lin, cycles[150].target).solve
    assert solve.status is SolveStatus.ITERATION_LIMIT
    assert solve.iterations <= 20
    assert "after 2" in solve.why
    assert "residual" in solve.why
