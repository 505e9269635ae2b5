"""Form of the problem: what is checked of a solution, and the sparse QP that stands for it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ltv_mpc.control.config import Weights
from ltv_mpc.control.ocp.problem import Problem, optimality_error, row_values
from ltv_mpc.control.problem_data import Constants
from ltv_mpc.control.solvers import riccati
from ltv_mpc.control.solvers.active_set import CONVERGED
from ltv_mpc.control.solvers.sparse import SparseLayout, fits, solution_of, sparse_qp
from ltv_mpc.control.solvers.sweep import Sweep
from tests.ltv_mpc.control.problems import LIMITS, PAPER, Form, motion, precise

N = 17
MOTION = Constants.of(PAPER, Weights(), LIMITS.t, np.array([[-0.1, -0.05], [0.2, 0.05]]))
KNOTS = np.array([*range(9), *(8.0 + 1.3 * k for k in range(1, 10))])


def anything(seed: int, n: int = 3, m: int = 2, M: int = 4, stages: int = 5) -> Problem:
    """Return a problem of any size, with hard and soft rows."""
    rng, p = np.random.default_rng(seed), Problem.empty(stages, n, m, M)
    p.F[...] = rng.normal(size=p.F.shape) * 0.6
    p.f[...], p.h[...] = rng.normal(size=p.f.shape), rng.normal(size=p.h.shape)
    root = rng.normal(size=p.H.shape)
    p.H[...] = root @ root.transpose(0, 2, 1) + 0.1 * np.eye(n + m)
    p.G[:, :2, n:] = rng.normal(size=(stages + 1, 2, m))
    p.G[-1, :, n:] = p.h[-1, n:] = p.H[-1, n:, :] = p.H[-1, :, n:] = 0.0
    p.low[:-1, :2], p.high[:-1, :2] = -0.5, 0.5
    p.G[:, 2:, :n] = rng.normal(size=(stages + 1, M - 2, n))
    p.high[1:, 2], p.low[1:, 3] = 0.3, -0.3
    p.penalty[1:, 2], p.penalty[1:, 3] = 2.0, 50.0
    return p


def solved(p: Problem):
    """Return states and inputs, and the duals."""
    work, y = Sweep.empty(p), np.zeros(p.low.shape)
    assert riccati.solve(p, work, np.arange(len(p.h) + 0.0), math.nan, y)[0] == CONVERGED
    return work.z, y


@pytest.mark.parametrize("sizes", [(3, 2), (1, 1), (6, 3)])
@pytest.mark.parametrize("seed", range(5))
def test_a_problem_of_any_size_has_the_optimum_of_its_sparse_qp(seed: int, sizes: tuple[int, int]) -> None:
    p = anything(seed, *sizes)
    z, y = solved(p)
    np.testing.assert_allclose(z, solution_of(p, precise(sparse_qp(p))), atol=1e-6)
    assert optimality_error(p, z, y) < 1e-6


def test_the_sparse_qp_is_the_problem() -> None:
    """Cost, dynamics, hard and soft rows of a random point, written out."""
    p, rng = anything(7), np.random.default_rng(7)
    layout, qp = SparseLayout(p), sparse_qp(p)
    x = rng.normal(size=len(qp.q))
    z, e = solution_of(p, x), np.abs(x[layout.places.excess]) * (layout.places.excess >= 0)
    x[layout.places.excess[layout.places.excess >= 0]] = e[layout.places.excess >= 0]
    cost = sum(0.5 * z[k] @ p.H[k] @ z[k] + p.h[k] @ z[k] for k in range(6)) + np.sum(
        np.where(np.isfinite(p.penalty), p.penalty, 0.0) * e
    )
    assert 0.5 * x @ (qp.P @ x) + qp.q @ x == pytest.approx(cost)
    g, rows = np.empty(p.low.shape), qp.A @ x
    row_values(p, z, g)
    kept = (g - e <= p.high).all() and (g + e >= p.low).all()
    gap = [p.F[k] @ z[k] + p.f[k] - z[k + 1, :3] for k in range(5)]
    np.testing.assert_allclose((rows - qp.l)[:15], np.concatenate(gap), atol=1e-12)
    limits = slice(15, None)
    assert bool((rows[limits] <= qp.u[limits]).all() and (rows[limits] >= qp.l[limits]).all()) == kept


def test_a_layout_says_what_does_not_fit_and_grows_by_it() -> None:
    p, other = anything(1), anything(1)
    p.F[2, 0, 1] = p.G[3, 2, 1] = 0.0
    layout = SparseLayout(p)
    assert fits(p, layout.masks)
    assert not fits(other, layout.masks)
    both = SparseLayout(other, layout)
    assert fits(p, both.masks)
    assert fits(other, both.masks)
    p.low[1, 2] = -1.0
    assert not fits(p, both.masks)


def of_vehicle(seed: int, limits: Constants):
    """Return a problem of a cycle, its solution and its duals."""
    lin, target = motion(seed, N, gap=0.01)
    target = np.column_stack([target, np.full(N + 1, 1.0)])
    p = Form(KNOTS, limits, Weights(heading_per_rad2=0.3)).problem(lin, target)
    return p, *solved(p)


@pytest.mark.parametrize("limits", [LIMITS, MOTION], ids=["box", "motion"])
def test_a_solution_has_no_optimality_error(limits: Constants) -> None:
    seen = set()
    for seed in range(8):
        p, z, y = of_vehicle(seed, limits)
        assert optimality_error(p, z, y) < 2e-6
        seen |= {i for k, i in np.argwhere(y)} | ({"exceeded"} if (np.abs(y) == p.penalty).any() else set())
    assert seen >= {0, 1, 2, 3}
    assert limits is LIMITS or seen >= {4, 5, "exceeded"}


def test_a_change_of_an_input_or_a_dual_is_seen() -> None:
    p, z, y = of_vehicle(1, MOTION)
    for k in range(N):
        for i in (10, 11):
            changed = z.copy()
            changed[k, i] += 0.002
            assert optimality_error(p, changed, y) > 1e-5
        for i in range(y.shape[1]):
            if np.isfinite(p.high[k, i]):
                changed = y.copy()
                changed[k, i] += 1e-2
                assert optimality_error(p, z, changed) > 1e-5


def test_rows_off_their_bounds_are_seen() -> None:
    """A value beyond a bound, a dual of a row inside its bounds, and a dual above its penalty."""
    for seed in range(8):
        p, z, y = of_vehicle(seed, MOTION)
        held = np.argwhere((np.abs(y) > 1e-2) & (np.abs(y) < p.penalty - 1e-2))
        exceeded = np.argwhere(np.abs(y) == p.penalty)
        g = np.empty(y.shape)
        row_values(p, z, g)
        for places, step in ((held, 1e-3), (held, -1e-3), (exceeded, -1e-3)):
            for k, i in places[:3]:
                bound = p.high if y[k, i] > 0.0 else p.low
                before = bound[k, i]
                bound[k, i] = g[k, i] - step * np.sign(y[k, i])
                assert optimality_error(p, z, y) > 1e-4
                bound[k, i] = before


def test_numbers_that_are_not_finite_are_an_infinite_error() -> None:
    p, z, y = of_vehicle(1, LIMITS)
    z[3, 10] = math.nan
    assert optimality_error(p, z, y) == math.inf
