"""DAQP on the condensed QP: exact, cycle after cycle, and as good after a failure as before."""

from __future__ import annotations

import numpy as np
import pytest

from ltv_mpc.control.config import SettledConfig
from ltv_mpc.control.qp.kkt import residuals
from ltv_mpc.control.solvers import daqp
from ltv_mpc.control.solvers.daqp import CondensedDaqp
from ltv_mpc.messages import SolveStatus
from tests.ltv_mpc.control.problems import LIMITS, LOWERED, motion, optimum, precise, solved

CONFIG = SettledConfig()


@pytest.mark.parametrize("limits", [LIMITS, LOWERED], ids=["box", "lowered box"])
@pytest.mark.parametrize("horizon_s", [0.3, 5.1, 10.2])
def test_its_commands_are_the_sparse_qp_s_optimum_from_any_cycle_before(horizon_s, limits):
    config = SettledConfig(horizon_s=horizon_s, period_s=0.3)
    solver = CondensedDaqp(config, limits)
    for seed in range(6):  # each has nothing to do with the one before
        lin, target = motion(seed, config.stages, gap=0.02)
        solver.shift(1.0)
        ours = solved(solver, lin, target)
        assert ours.solve.status is SolveStatus.SOLVED
        np.testing.assert_array_equal(ours.commands[0], lin.U[0])
        np.testing.assert_allclose(ours.commands, optimum(lin, target, limits, config.weights), atol=1e-6)


def test_a_warm_start_saves_iterations_and_forgetting_gives_them_back():
    solver = CondensedDaqp(CONFIG, LOWERED)
    lin, target = motion(4, CONFIG.stages)
    cold = solved(solver, lin, target).solve.iterations
    warm = solved(solver, lin, target).solve.iterations
    solver.forget()
    assert solved(solver, lin, target).solve.iterations == cold > warm


def test_the_problem_is_the_one_that_was_solved():
    solver = CondensedDaqp(CONFIG, LIMITS)
    lin, target = motion(1, CONFIG.stages)
    commands = solved(solver, lin, target).commands
    z = ((commands - lin.U)[1:] / LIMITS.scale).ravel()
    qp = solver.problem()
    np.testing.assert_allclose(z, precise(qp), atol=1e-8)
    assert residuals(qp, z, np.zeros(len(qp.l))).primal <= daqp.VIOLATION


@pytest.mark.parametrize("field", ["X", "A"])
def test_a_problem_that_is_not_finite_is_reported_and_leaves_nothing_behind(field):
    solver = CondensedDaqp(CONFIG, LOWERED)
    lin, target = motion(2, CONFIG.stages)
    fresh = solved(solver, lin, target)
    bad = getattr(lin, field).copy()
    bad[3] = np.nan
    failed = solved(solver, lin._replace(**{field: bad}), target)
    assert failed.solve.status is SolveStatus.NON_FINITE
    assert failed.solve.why == f"{field} is not finite from 3 on"
    np.testing.assert_array_equal(failed.commands, lin.U)
    again = solved(solver, lin, target)
    assert again.solve.iterations == fresh.solve.iterations
    np.testing.assert_array_equal(again.commands, fresh.commands)


def test_a_first_problem_that_is_not_finite_is_no_harm_either():
    solver = CondensedDaqp(CONFIG, LIMITS)
    lin, target = motion(2, CONFIG.stages)
    assert solved(solver, lin, np.full_like(target, np.inf)).solve.status is SolveStatus.NON_FINITE
    assert solved(solver, lin, target).solve.status is SolveStatus.SOLVED


class Stubborn:
    """DAQP that ends with a flag of one's choice, as often as said."""

    def __init__(self, real, flag, times):
        self._real, self._flag, self._times = real, flag, times

    def update(self, **numbers):
        return self._real.update(**numbers)

    def solve(self):
        z, value, flag, info = self._real.solve()
        if self._times > 0:
            self._times -= 1
            return np.full_like(z, np.nan) if self._flag > 0 else z, value, self._flag, info
        return z, value, flag, info


@pytest.mark.parametrize(
    ("flag", "status", "words"),
    [
        (-1, SolveStatus.INFEASIBLE, "infeasible"),
        (-2, SolveStatus.FAILED, "repeats"),
        (-4, SolveStatus.ITERATION_LIMIT, "limit"),
        (-9, SolveStatus.FAILED, "flag -9"),
        (1, SolveStatus.NON_FINITE, "not finite"),
    ],
)
def test_a_failure_is_tried_once_from_nothing_then_reported_and_then_forgotten(flag, status, words):
    solver = CondensedDaqp(CONFIG, LOWERED)
    lin, target = motion(5, CONFIG.stages)
    expected = solved(solver, lin, target)
    solver._model = Stubborn(solver._model, flag, 1)
    if flag < 0:
        np.testing.assert_allclose(solved(solver, lin, target).commands, expected.commands, atol=1e-9)
        solver._model = Stubborn(solver._model, flag, 2)
    failed = solved(solver, lin, target)
    assert failed.solve.status is status
    assert words in failed.solve.why
    np.testing.assert_array_equal(failed.commands, lin.U)
    again = solved(solver, lin, target)
    assert again.solve.iterations == expected.solve.iterations
    np.testing.assert_array_equal(again.commands, expected.commands)
