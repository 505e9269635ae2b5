"""Optimality error: nothing at the optimum, and as much as a change of it violates the conditions."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ltv_mpc.control.config import Weights
from ltv_mpc.control.horizon_limits import HorizonLimits
from ltv_mpc.control.problem_data import pack_objective, unpack_objective
from ltv_mpc.control.qp.optimality import optimality_error
from ltv_mpc.control.qp.riccati import sweep_workspace
from ltv_mpc.control.solvers import riccati_solver
from tests.ltv_mpc.control.problems import LIMITS, PAPER, motion

N = 17
BOUNDS = np.array([[-0.1, -0.05], [0.2, 0.05]])
MOTION = HorizonLimits.from_vehicle(PAPER, 0.3, BOUNDS)
KNOTS = np.array([*range(9), *(8.0 + 1.3 * k for k in range(1, 10))])


def solution(seed: int, limits: HorizonLimits):
    """Return a function that gives the error of changed duals and commands, then the duals, commands and bounds."""
    lin, target = motion(seed, N, gap=0.01)
    target = np.column_stack([target, np.full(N + 1, 1.0)])
    o = unpack_objective(pack_objective(KNOTS, limits, Weights(heading_per_rad2=0.3)))
    work, y, dU = sweep_workspace(lin, target, o), np.zeros((N, 4 + len(limits.limited_states))), np.zeros((N + 1, 2))
    outcome, _, _ = riccati_solver.solve(lin, target, o, work, 60, y, dU)
    assert outcome == riccati_solver.CONVERGED
    return (lambda y, dU: optimality_error(lin, target, o, work, y, dU)), y, dU, work


@pytest.mark.parametrize("limits", [LIMITS, MOTION], ids=["box", "motion"])
def test_a_solution_has_no_error(limits):
    seen = set()
    for seed in range(8):
        error, y, dU, work = solution(seed, limits)
        assert error(y, dU) < 1e-6
        seen |= {i for k, i in np.argwhere(y)} | ({"exceeded"} if (np.abs(y) == work.cap).any() else set())
    assert seen >= {0, 1, 2, 3}
    assert limits is LIMITS or seen >= {4, 5, "exceeded"}


def test_a_change_of_a_command_or_a_dual_is_seen():
    error, y, dU, _ = solution(1, MOTION)
    for k in range(N):
        for i in range(2):
            changed = dU.copy()
            changed[k + 1, i] += 0.1
            assert error(y, changed) > 1e-5
        for i in range(y.shape[1]):
            changed = y.copy()
            changed[k, i] += 1e-2
            assert error(changed, dU) > 1e-5


def test_rows_off_their_bounds_are_seen():
    """A value beyond a bound, a dual of a row inside its bounds, and a dual above its cap."""
    for seed in range(8):
        error, y, dU, work = solution(seed, MOTION)
        held = np.argwhere((np.abs(y) > 1e-2) & (np.abs(y) < work.cap - 1e-2))
        exceeded = np.argwhere(np.abs(y) == work.cap)
        for places, step in ((held, 1e-3), (held, -1e-3), (exceeded, -1e-3)):
            for k, i in places[:3]:
                before, bound = work.g[k, i], work.high[k, i] if y[k, i] > 0.0 else work.low[k, i]
                work.g[k, i] = bound + step * np.sign(y[k, i])
                assert error(y, dU) > 1e-4
                work.g[k, i] = before


def test_numbers_that_are_not_finite_are_an_infinite_error():
    error, y, dU, _ = solution(1, LIMITS)
    dU[3, 0] = math.nan
    assert error(y, dU) == math.inf
