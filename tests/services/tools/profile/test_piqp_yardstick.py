"""PIQP by its own interface: the optimum, cycle after cycle, and as good after a failure as before."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ltv_mpc.control.config import ResolvedConfig, Weights
from ltv_mpc.control.linearisation import linearise
from ltv_mpc.control.ocp.assembly import problem_along
from ltv_mpc.control.ocp.problem import Problem
from ltv_mpc.control.problem_data import Constants
from ltv_mpc.control.solvers import Result, solve_qp
from ltv_mpc.control.solvers.sparse import solution_of, sparse_qp
from ltv_mpc.messages import SolveStatus
from ltv_mpc.vehicle.parameters import Vehicle
from services.tools.profile.piqp_yardstick import PiqpYardstick

PAPER = Vehicle.load("paper")
CONFIG = ResolvedConfig(horizon_s=5.0, weights=Weights())
BOX = Constants.of(PAPER, CONFIG.weights, CONFIG.knots)
LOWERED = BOX._replace(low=0.4 * BOX.low, high=0.4 * BOX.high)  # commands may be outside
TURNS_SLOWLY = Constants.of(PAPER, CONFIG.weights, CONFIG.knots, np.array([[-np.inf, -0.15], [np.inf, 0.15]]))


def problem(seed: int, limits: Constants = BOX) -> Problem:
    """Return a problem along states and commands drawn at random; every other one ends at rest: some of H is 0."""
    draw, N = np.random.default_rng(seed), CONFIG.stages
    X, U = draw.normal(size=(N + 1, 8)) * [0.5, 0.5, 0.1, 0.1, 0.3, 0.1, 20.0, 20.0], draw.uniform(-40, 40, (N + 1, 2))
    X[-1, 2:4] *= seed % 2
    lin = linearise(X, U, draw.normal(size=(N + 1, 2)) * 0.05, 0.3, PAPER.coefficients())
    return problem_along(lin, draw.normal(size=(N + 1, 2)), limits)


def solved(solver: PiqpYardstick, of: Problem) -> Result:
    return solver.solve(of, math.nan)


@pytest.mark.parametrize("limits", [BOX, LOWERED, TURNS_SLOWLY], ids=["box", "lowered box", "yaw rate"])
def test_its_solutions_are_those_of_an_active_set_method(limits: Constants) -> None:
    solver = PiqpYardstick(1e-11)
    for seed in (1, 2, 3, 4):  # the second and later ones update the first one's workspace
        of = problem(seed, limits)
        ours = solved(solver, of)
        assert ours.solve.status is SolveStatus.SOLVED
        np.testing.assert_allclose(ours.z, solution_of(of, solve_qp(sparse_qp(of), "daqp").x), atol=1e-5)


def test_a_problem_that_is_not_finite_is_reported_and_leaves_nothing_behind() -> None:
    solver, of = PiqpYardstick(), problem(2)
    expected = solved(solver, of)
    failed = solved(solver, of._replace(h=np.full_like(of.h, np.nan)))
    assert failed.solve.status is SolveStatus.NON_FINITE
    assert not failed.z.any()
    np.testing.assert_allclose(solved(solver, of).z, expected.z, rtol=0, atol=1e-7)
