"""OSQP on the sparse QP: near the exact optimum in a closed loop, at it when asked to be precise."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from ltv_mpc.control.config import ResolvedConfig, Weights
from ltv_mpc.control.qp.problem import residuals
from ltv_mpc.control.qp.sparse import STAGE_VARIABLES
from ltv_mpc.control.solvers import osqp, osqp_workspace
from ltv_mpc.control.solvers.osqp import OsqpSolver
from ltv_mpc.control.solvers.osqp_workspace import PublicWorkspace
from ltv_mpc.messages import SolveStatus
from tests.ltv_mpc.control.problems import LIMITS, LOWERED, answer, motion, optimum

CONFIG = ResolvedConfig(horizon_s=5.1, weights=Weights())
PRECISE = msgspec.structs.replace(CONFIG, tolerance=1e-12, max_iterations=6000)
"""Residuals end at 1e-6, which is rounding on rows scaled by 300."""


@pytest.mark.parametrize("limits", [LIMITS, LOWERED], ids=["box", "lowered box"])
@pytest.mark.parametrize("stages", [1, 17, 34])
def test_its_commands_are_the_sparse_qp_s_optimum(stages, limits):
    config = msgspec.structs.replace(PRECISE, horizon_s=0.3 * stages, period_s=0.3)
    solver = OsqpSolver(config, limits)
    for seed in range(3):
        lin, target = motion(seed, stages, gap=0.02)
        ours = answer(solver, lin, target)
        np.testing.assert_array_equal(ours.commands[0], lin.U[0])
        np.testing.assert_allclose(ours.commands, optimum(lin, target, limits, config.weights), atol=1e-3)


def test_the_first_free_knot_is_within_0_1_N_in_99_percent_of_a_closed_loop(cycles):
    solver = OsqpSolver(CONFIG, LIMITS)
    off, iterations = [], []
    for cycle in cycles:
        ours = answer(solver, cycle.lin, cycle.target, cycle.stages)
        assert ours.solve.status is SolveStatus.SOLVED
        exact = optimum(cycle.lin, cycle.target, LIMITS, CONFIG.weights)
        off.append(np.abs(ours.commands[1] - exact[1]).max())
        iterations.append(ours.solve.iterations)
    assert len(off) >= 200
    assert np.mean(np.array(off) <= 0.1) >= 0.99
    assert max(off) <= 1.0
    assert np.median(iterations) <= 6


def test_without_limits_the_first_guess_obeys_the_model_and_is_stationary():
    """Gaps closed by a forward sweep, duals of the dynamics by a backward one: their residuals are zero."""
    solver = OsqpSolver(CONFIG, LIMITS)
    lin, target = motion(3, CONFIG.stages, gap=0.02)
    solver.reset_warm_start()
    solver.build(lin, target)
    (x, y), qp = solver.point(), solver.problem()
    equal = solver.form.equalities
    np.testing.assert_allclose((qp.A @ x)[:equal], qp.l[:equal], atol=1e-9)
    slope = qp.P @ x + qp.q + qp.A.T @ y
    thrusts = np.zeros(len(x), dtype=bool)
    thrusts[:-2].reshape(-1, STAGE_VARIABLES)[:, 8:] = True
    np.testing.assert_allclose(slope[~thrusts], 0.0, atol=1e-9 * np.abs(y).max())
    states = x[:-2].reshape(-1, STAGE_VARIABLES)[:, :6]
    assert np.abs(states * LIMITS.state_scale).max() > 1e-3  # there were gaps to close


def test_the_first_guess_is_nearly_always_the_solution(cycles):
    solver = OsqpSolver(CONFIG, LIMITS)
    for cycle in cycles:
        solver.reset_warm_start() if math.isnan(cycle.stages) else solver.shift_warm_start(cycle.stages)
        solver.build(cycle.lin, cycle.target)
        kkt = residuals(solver.problem(), *solver.point())
        assert max(kkt.stationarity, kkt.primal, kkt.complementarity) <= 2e-5
        solver.update()
        assert solver.solve().solve.iterations == osqp.FIRST_BATCH


@pytest.mark.parametrize("off_m", [10.0, 100.0])
def test_far_from_its_line_it_ends_as_soon(off_m):
    """Duals grow with the distance, and with them what rounding leaves of OSQP's own solution."""
    solver = OsqpSolver(CONFIG, LIMITS)
    for seed in range(8):
        lin, target = motion(seed, CONFIG.stages)
        target[:-1] += off_m
        ours = answer(solver, lin, target)
        assert ours.solve.status is SolveStatus.SOLVED
        assert ours.solve.iterations <= osqp.FIRST_BATCH + osqp.BATCH
        np.testing.assert_allclose(ours.commands, optimum(lin, target, LIMITS, CONFIG.weights), atol=0.01)


def test_without_sweeps_osqp_starts_from_the_trajectory_and_the_last_duals():
    """A cost that does not say what the last command should be: no weight on thrust, no effect of the last one."""
    weights = Weights(thrust=0.0, thrust_change=0.0)
    solver = OsqpSolver(msgspec.structs.replace(PRECISE, weights=weights, horizon_s=1.5), LIMITS)
    lin, target = motion(3, 5)
    lin.B1[-1] = 0.0
    answer(solver, lin, target)
    x, y = solver.point()
    solver.shift_warm_start(0.0)
    solver.build(lin, target)
    again, duals = solver.point()
    assert np.abs(x[:-2].reshape(-1, STAGE_VARIABLES)[:, 8:]).max() > 0.1
    np.testing.assert_array_equal(again[:-2].reshape(-1, STAGE_VARIABLES)[:, 8:], 0.0)
    assert np.abs(duals[solver.form.equalities :]).max() > 0.0
    np.testing.assert_array_equal(duals[solver.form.equalities :], y[solver.form.equalities :])


def test_duals_between_stages_are_read_linearly_and_the_last_ones_kept():
    N = 5
    rows = np.random.default_rng(2).normal(size=(2, N, 2))  # of slew, of box
    E = 8 * N + 2
    for by in (0.0, 0.4, 1.0, 1.7, 9.0):
        y = np.concatenate([np.zeros(E), rows.ravel()])
        osqp._shift_limits(y, E, 0, np.arange(N + 1.0), by)
        at = np.clip(np.arange(N) + by, 0, N - 1)
        want = [[np.interp(at, range(N), kind[:, i]) for i in range(2)] for kind in rows]
        np.testing.assert_allclose(y[E:].reshape(2, N, 2), np.array(want).transpose(0, 2, 1))


def test_the_tolerance_is_on_the_residuals(cycles):
    precise = msgspec.structs.replace(CONFIG, tolerance=1e-6, max_iterations=5000)
    solver = OsqpSolver(precise, LIMITS)
    for cycle in cycles[::20]:
        answer(solver, cycle.lin, cycle.target)
        kkt = residuals(solver.problem(), *solver.point())
        # the tolerance grows with the gradient; the rows of free limits are scaled down, and so is their violation
        size = osqp.dual_scale(solver.problem().q, CONFIG.stages)
        assert kkt.stationarity <= 1e-6 * size
        assert kkt.primal <= 1e-6 * size / osqp.LIMIT_ROW
        assert kkt.complementarity <= 1e-4


def test_a_solve_depends_on_its_problem_and_its_first_guess_alone(cycles):
    """Replay needs the same bits whatever was solved before."""
    used, fresh = OsqpSolver(CONFIG, LIMITS), OsqpSolver(CONFIG, LIMITS)
    for cycle in cycles[150:160]:
        answer(used, cycle.lin, cycle.target)
    first = cycles[20]
    ours, theirs = (answer(s, first.lin, first.target) for s in (used, fresh))
    np.testing.assert_array_equal(ours.commands, theirs.commands)


def test_the_public_wrapper_gives_the_same_commands(cycles, monkeypatch):
    raw = OsqpSolver(CONFIG, LIMITS)
    ours = [answer(raw, c.lin, c.target, c.stages) for c in cycles[::10]]
    monkeypatch.setattr(osqp_workspace, "c_functions_work", lambda: False)
    public = OsqpSolver(CONFIG, LIMITS)
    theirs = [answer(public, c.lin, c.target, c.stages) for c in cycles[::10]]
    assert isinstance(public._workspace, PublicWorkspace)
    for a, b in zip(ours, theirs, strict=True):
        np.testing.assert_array_equal(a.commands, b.commands)
        assert a.solve.iterations == b.solve.iterations


@pytest.mark.parametrize("field", ["X", "Phi", "A", "B0", "B1"])
def test_a_problem_that_is_not_finite_is_reported_and_leaves_nothing_behind(cycles, field):
    good, target = cycles[30].lin, cycles[30].target
    bad = type(good).from_arrays(*good[:-1])
    getattr(bad, field)[4] = np.nan
    used, fresh = OsqpSolver(CONFIG, LIMITS), OsqpSolver(CONFIG, LIMITS)
    answer(used, good, target)
    failed = answer(used, bad, target)
    assert failed.solve.status is SolveStatus.NON_FINITE
    assert field in failed.solve.why
    ours, theirs = (answer(s, good, target) for s in (used, fresh))
    np.testing.assert_array_equal(ours.commands, theirs.commands)


def test_an_answer_that_is_not_finite_is_reported_and_the_workspace_rebuilt(cycles):
    class Poisoned:
        def __init__(self, real):
            self.real = real

        def __getattr__(self, name):
            return getattr(self.real, name)

        @property
        def x(self):
            return np.full_like(self.real.x, np.nan)

    solver, lin, target = OsqpSolver(CONFIG, LIMITS), cycles[30].lin, cycles[30].target
    good = answer(solver, lin, target)
    solver._workspace = Poisoned(solver._workspace)
    failed = answer(solver, lin, target)
    assert failed.solve.status is SolveStatus.NON_FINITE
    assert "rebuilt" in failed.solve.why
    np.testing.assert_array_equal(answer(solver, lin, target).commands, good.commands)


def test_the_iteration_limit_ends_a_solve_and_says_so(cycles):
    config = msgspec.structs.replace(CONFIG, tolerance=1e-14, max_iterations=20)
    solve = answer(OsqpSolver(config, LIMITS), cycles[150].lin, cycles[150].target).solve
    assert solve.status is SolveStatus.ITERATION_LIMIT
    assert solve.iterations <= 20 + osqp.BATCH
    assert "after 2" in solve.why
    assert "residual" in solve.why
