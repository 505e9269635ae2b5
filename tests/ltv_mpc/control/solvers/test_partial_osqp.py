"""OSQP on the partially condensed QP: near the exact optimum in a closed loop, at it when asked to be precise."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from ltv_mpc.control.config import SettledConfig
from ltv_mpc.control.qp.kkt import residuals
from ltv_mpc.control.solvers import partial_osqp
from ltv_mpc.control.solvers.daqp import CondensedDaqp
from ltv_mpc.control.solvers.osqp_raw import PublicWorkspace
from ltv_mpc.control.solvers.partial_osqp import PartialOsqp
from ltv_mpc.messages import SolveStatus
from tests.ltv_mpc.control.problems import LIMITS, LOWERED, motion, optimum, solved

CONFIG = SettledConfig()
PRECISE = msgspec.structs.replace(CONFIG, tolerance=1e-12, max_iterations=20_000)
"""Residuals end at 1e-7, which is rounding on rows scaled by 100."""


@pytest.mark.parametrize("limits", [LIMITS, LOWERED], ids=["box", "lowered box"])
@pytest.mark.parametrize(("stages", "block"), [(1, 5), (17, 5), (17, 2), (34, 5)])
def test_its_commands_are_the_sparse_qp_s_optimum(stages, block, limits, monkeypatch):
    monkeypatch.setattr(partial_osqp, "VIOLATION", 1e-10)
    config = msgspec.structs.replace(PRECISE, horizon_s=0.3 * stages, period_s=0.3)
    solver = PartialOsqp(config, limits, block=block)
    for seed in range(3):  # each has nothing to do with the one before
        lin, target = motion(seed, stages, gap=0.02)
        solver.shift(1.0)
        ours = solved(solver, lin, target)
        np.testing.assert_array_equal(ours.commands[0], lin.U[0])
        np.testing.assert_allclose(ours.commands, optimum(lin, target, limits, config.weights), atol=1e-6)


def test_the_first_free_knot_is_within_a_tenth_of_a_newton_in_99_percent_of_a_closed_loop(cycles):
    solver, exact = PartialOsqp(CONFIG, LIMITS), CondensedDaqp(CONFIG, LIMITS)
    off, iterations, unsolved = [], [], 0
    for cycle in cycles[6:]:  # without the first passes, which have no warm start
        solver.shift(1.0)
        ours, theirs = (solved(s, cycle.lin, cycle.target) for s in (solver, exact))
        off.append(np.abs(ours.commands[1] - theirs.commands[1]).max())
        iterations.append(ours.solve.iterations)
        unsolved += ours.solve.status is not SolveStatus.SOLVED
    assert len(off) >= 200
    assert np.mean(np.array(off) <= 0.1) >= 0.99
    assert max(off) <= 1.0
    assert np.percentile(iterations, 99) <= 1
    assert unsolved == 0


@pytest.mark.parametrize("block", [1, 5, 20])
def test_the_first_guess_is_nearly_always_the_solution(cycles, block):
    solver = PartialOsqp(CONFIG, LIMITS, block=block)
    for cycle in cycles:
        solver.forget() if math.isnan(cycle.stages) else solver.shift(cycle.stages)
        solver.build(cycle.lin, cycle.target)
        kkt = residuals(solver.problem(), solver._x, solver._dual)
        assert max(kkt.stationarity, kkt.primal, kkt.complementarity) <= 2e-5
        solver.update()
        assert solver.solve().solve.iterations == partial_osqp.CHECK


def test_box_and_slew_are_met_to_the_tolerance_though_free_rows_are_scaled_down(cycles):
    solver = PartialOsqp(CONFIG, LIMITS)
    for cycle in cycles[::5]:
        solver.forget()
        ours = solved(solver, cycle.lin, cycle.target)
        if ours.solve.status is SolveStatus.SOLVED:
            slack = 1.01 * partial_osqp.VIOLATION * LIMITS.scale
            assert (ours.commands[1:] <= LIMITS.high + slack).all()
            assert (ours.commands[1:] >= LIMITS.low - slack).all()
            assert (np.abs(np.diff(ours.commands, axis=0)) <= LIMITS.change + slack).all()


def test_a_whole_number_of_stages_moves_the_duals_by_as_many_and_keeps_the_first_bound_s_share():
    solver = PartialOsqp(CONFIG, LIMITS)
    form = solver._form
    N, first = form.stages, form.states
    dual = np.random.default_rng(0).normal(size=form.rows)
    box, slew = dual[first : first + 2 * N].reshape(N, 2).copy(), dual[first + 2 * N :].reshape(N - 1, 2).copy()
    solver._dual[:] = dual
    solver.shift(2.0)
    np.testing.assert_array_equal(solver._dual[:first], 0.0)
    moved = solver._dual[first : first + 2 * N].reshape(N, 2)
    np.testing.assert_allclose(moved[0], box[2] + slew[1])  # of z_1, box and slew in one
    np.testing.assert_allclose(moved[1:-2], box[3:])
    np.testing.assert_allclose(moved[-2:], box[[-1, -1]])
    np.testing.assert_allclose(solver._dual[first + 2 * N :].reshape(N - 1, 2)[:-2], slew[2:])
    half = PartialOsqp(CONFIG, LIMITS)
    half._dual[:] = dual
    half.shift(0.5)
    np.testing.assert_allclose(half._dual[first + 2 : first + 4], 0.5 * (box[1] + box[2]))


def test_a_solve_depends_on_its_problem_and_its_first_guess_alone():
    used, fresh = PartialOsqp(CONFIG, LOWERED), PartialOsqp(CONFIG, LOWERED)
    for seed in range(3):
        solved(used, *motion(seed, CONFIG.stages))
    used.forget()
    problem = motion(7, CONFIG.stages, gap=0.02)
    ours, theirs = (solved(solver, *problem) for solver in (used, fresh))
    assert ours.solve.iterations == theirs.solve.iterations
    np.testing.assert_allclose(ours.commands, theirs.commands, atol=1e-9)


def test_the_public_wrapper_gives_the_same_commands(monkeypatch):
    ours = PartialOsqp(CONFIG, LOWERED)
    expected = [solved(ours, *motion(seed, CONFIG.stages, gap=0.02)) for seed in range(4)]
    monkeypatch.setattr(partial_osqp, "workspace", PublicWorkspace)
    other = PartialOsqp(CONFIG, LOWERED)
    for seed, ours_then in enumerate(expected):
        theirs = solved(other, *motion(seed, CONFIG.stages, gap=0.02))
        np.testing.assert_array_equal(theirs.commands, ours_then.commands)
        assert theirs.solve.iterations == ours_then.solve.iterations


@pytest.mark.parametrize("first", [False, True])
@pytest.mark.parametrize("field", ["X", "A"])
def test_a_problem_that_is_not_finite_is_reported_and_leaves_nothing_behind(field, first):
    lin, target = motion(2, CONFIG.stages)
    expected = solved(PartialOsqp(CONFIG, LOWERED), lin, target)
    solver = PartialOsqp(CONFIG, LOWERED)
    if not first:
        solved(solver, lin, target)
    bad = getattr(lin, field).copy()
    bad[3] = np.nan
    failed = solved(solver, lin._replace(**{field: bad}), target)
    assert failed.solve.status is SolveStatus.NON_FINITE
    assert failed.solve.why == f"{field} is not finite from 3 on"
    np.testing.assert_array_equal(failed.commands, lin.U)
    np.testing.assert_allclose(solved(solver, lin, target).commands, expected.commands, atol=1e-9)


class Spoiled:
    """A workspace whose next answer is not finite."""

    def __init__(self, real):
        self._real = real

    def __getattr__(self, name):
        return getattr(self._real, name)

    def read(self):
        x, y = self._real.read()
        return x * np.nan, y


def test_an_answer_that_is_not_finite_is_reported_and_the_workspace_rebuilt():
    lin, target = motion(2, CONFIG.stages)
    solver = PartialOsqp(CONFIG, LOWERED)
    expected = solved(solver, lin, target)
    solver._solver = Spoiled(solver._solver)
    failed = solved(solver, lin, target)
    assert failed.solve.status is SolveStatus.NON_FINITE
    assert "rebuilt" in failed.solve.why
    again = solved(solver, lin, target)
    np.testing.assert_array_equal(again.commands, expected.commands)


def test_the_iteration_limit_ends_a_solve_and_says_so():
    config = msgspec.structs.replace(CONFIG, max_iterations=3, tolerance=1e-14)
    solve = solved(PartialOsqp(config, LOWERED), *motion(2, CONFIG.stages)).solve
    assert solve.status is SolveStatus.ITERATION_LIMIT
    assert solve.iterations == 6
    assert "after 6 iterations" in solve.why
