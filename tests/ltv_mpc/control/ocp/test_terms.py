"""Every term of the cost: value against model, felt by every solver; a new weight is tested without an edit here."""

from __future__ import annotations

import math

import numpy as np
import pytest
from msgspec.structs import asdict

from ltv_mpc.control.config import ResolvedConfig, Weights
from ltv_mpc.control.linearisation import Linearisation, velocity_over_ground
from ltv_mpc.control.ocp import assembly, terms
from ltv_mpc.control.ocp.problem import Problem
from ltv_mpc.control.problem_data import Constants
from ltv_mpc.control.solvers import SOLVERS
from ltv_mpc.control.solvers.sparse import solution_of, sparse_qp
from ltv_mpc.messages import Array, SolveStatus
from tests.ltv_mpc.control.problems import LIMITS, PAPER, Form, motion, precise

N = 6
KNOTS = np.array([0.0, 1.0, 2.0, 3.0, 4.3, 6.0, 8.2])
WEIGHTS = Weights(**{name: weight or 0.4 for name, weight in asdict(Weights(thrust=0.2, thrust_change=0.1)).items()})
CONSTANTS = Form(KNOTS, LIMITS, WEIGHTS).constants
SCALES = assembly.scales(PAPER)
TERMS = Weights.__struct_fields__
OF_TERM = pytest.mark.parametrize("term", TERMS)


def trajectory(seed: int) -> tuple[Linearisation, Array]:
    """Return a motion and a target whose headings are up to half a turn off."""
    lin, target = motion(seed, N)
    headings = np.random.default_rng(seed).uniform(-3.0, 3.0, N + 1)
    return lin, np.column_stack([target, headings])


def alone(term: str) -> Constants:
    """Return the constants in which no other term has a weight."""
    return CONSTANTS._replace(weights=CONSTANTS.weights * [other == term for other in TERMS])


def value(term: str, lin: Linearisation, target: Array, z: Array) -> float:
    """Return the value along the trajectory that deviations z (N+1, 12) lead to."""
    X, U = lin.X + z[:, :8] * SCALES[:8], lin.U + z[:, 8:10] * SCALES[8:10]
    return float(terms.cost(X, U, lin.C, target, alone(term), None))


def model(term: str, lin: Linearisation, target: Array) -> Problem:
    """Return a problem with this term alone."""
    p = assembly.empty(N)
    terms.cost(lin.X, lin.U, lin.C, target, alone(term), p)
    return p


def deviation(seed: int) -> Array:
    """Return deviations (N+1, 12) from a trajectory, whose commands follow from their changes."""
    z = np.random.default_rng(seed).normal(size=(N + 1, 12))
    z[0, :10] = z[-1, 10:] = 0.0
    z[1:, 8:10] = np.cumsum(z[:-1, 10:], axis=0)
    return z


@OF_TERM
@pytest.mark.parametrize("seed", range(20))
def test_the_model_has_value_and_slope_of_the_exact_term(term: str, seed: int) -> None:
    """By central differences in a random direction; a sign or a factor that is wrong changes the slope."""
    lin, target = trajectory(seed)
    p, z, h = model(term, lin, target), deviation(seed), 1e-5
    slope = (value(term, lin, target, h * z) - value(term, lin, target, -h * z)) / (2.0 * h)
    assert float(np.sum(p.h * z)) == pytest.approx(slope, rel=1e-5, abs=1e-7)
    curvature = float(np.einsum("ki,kij,kj", z, p.H, z))
    assert abs(slope) + curvature > 1e-6  # it is there
    assert curvature >= 0.0
    np.testing.assert_allclose(p.H, p.H.transpose(0, 2, 1), atol=1e-12)
    if term != "terminal_velocity_s2_per_m2":  # its model leaves out a part of the curvature
        assert curvature == pytest.approx(second_difference(term, lin, target, z), rel=1e-4, abs=1e-6)


def second_difference(term: str, lin: Linearisation, target: Array, z: Array, h: float = 1e-3) -> float:
    """Return the second derivative of a term's value along z."""
    below, here, above = (value(term, lin, target, step * z) for step in (-h, 0.0, h))
    return (below + above - 2.0 * here) / h**2


def test_the_model_of_the_terminal_velocity_is_exact_where_its_error_is_zero() -> None:
    lin, target = trajectory(3)
    target[N, :2] = velocity_over_ground(lin.X[N], lin.C[N])[0]
    p, z = model("terminal_velocity_s2_per_m2", lin, target), deviation(0)
    curvature = float(np.einsum("ki,kij,kj", z, p.H, z))
    assert curvature == pytest.approx(second_difference("terminal_velocity_s2_per_m2", lin, target, z, 1e-4), rel=1e-4)


@OF_TERM
@pytest.mark.parametrize("name", SOLVERS)
def test_every_solver_feels_it(term: str, name: str) -> None:
    """The optimum moves when the term counts three times, and the solver finds it."""
    lin, target = trajectory(2)
    form = Form(KNOTS, LIMITS, WEIGHTS)
    config = ResolvedConfig(horizon_s=2.4, max_stages=N, weights=WEIGHTS, tolerance=1e-7, max_iterations=5000)
    once, more = form.problem(lin, target), form.problem(lin, target)
    for _ in range(2):
        terms.cost(lin.X, lin.U, lin.C, target, alone(term), more)
    before, wanted = (form.commands(lin, solution_of(p, precise(sparse_qp(p)))) for p in (once, more))
    assert np.abs(before - wanted).max() > 0.01
    result = SOLVERS[name](config).solve(more, math.nan)
    assert result.solve.status is SolveStatus.SOLVED
    np.testing.assert_allclose(form.commands(lin, result.z), wanted, atol=5e-3)


def test_all_terms_are_in_cost_and_problem() -> None:
    lin, target = trajectory(1)
    whole = assembly.problem_along(lin, target, CONSTANTS)
    parts = [model(term, lin, target) for term in TERMS]
    np.testing.assert_allclose(whole.H, sum(p.H for p in parts), atol=1e-12)
    np.testing.assert_allclose(whole.h, sum(p.h for p in parts), atol=1e-12)
    nowhere = np.zeros((N + 1, 12))
    of_all = assembly.cost(lin.X, lin.U, lin.C, target, CONSTANTS)
    assert of_all == pytest.approx(sum(value(term, lin, target, nowhere) for term in TERMS))
