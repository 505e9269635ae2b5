"""Problems for every solver, and their optimum by a solver that shares nothing with them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import piqp
from msgspec.structs import astuple
from scipy.sparse import csc_matrix

from ltv_mpc.control.config import Weights
from ltv_mpc.control.linearisation import Linearisation, linearise, roll_out
from ltv_mpc.control.ocp.assembly import problem_along
from ltv_mpc.control.ocp.problem import Problem
from ltv_mpc.control.problem_data import CHANGES, COMMANDS, Constants
from ltv_mpc.control.solvers import SOLVERS, Solver, solve_qp
from ltv_mpc.control.solvers.sparse import QP, solution_of, sparse_qp
from ltv_mpc.messages import Array, Solve, SolveStatus
from ltv_mpc.vehicle.parameters import Vehicle

PAPER = Vehicle.load("paper")

SOLVER_NAMES = (*SOLVERS, "piqp", "daqp")
"""Every solver of the table, and two backends of qpsolvers: an interior-point and an active-set method."""

LIMITS = Constants.of(PAPER, Weights(), np.arange(2.0))
LOWERED = LIMITS._replace(
    low=0.4 * LIMITS.low, high=np.array([0.4, 0.3]) * LIMITS.high, thrust_scale=0.4 * LIMITS.thrust_scale
)
"""A box that was just made smaller: a command can be outside of it."""


def equidistant(stages: int) -> Array:
    """Knots (N+1,) of so many stages."""
    return np.arange(stages + 1.0)


def motion(seed: int, stages: int, *, gap: float = 0.0) -> tuple[Linearisation, Array]:
    """Linearised along a motion of the paper's vehicle whose knots are off it by ``gap``; and a target (N+1, 2)."""
    rng = np.random.default_rng(seed)
    X0 = np.concatenate([rng.normal(size=2), rng.normal(size=2) * 0.2, [rng.uniform(-3, 3)], rng.normal(size=1) * 0.2])
    U = np.empty((stages + 1, 2))
    U[0] = rng.uniform(-50, 50, 2)
    for k in range(stages):
        U[k + 1] = np.clip(U[k] + rng.uniform(-1, 1, 2) * LIMITS.max_change, LIMITS.low, LIMITS.high)
    C = rng.normal(size=(stages + 1, 2)) * 0.05
    p = PAPER.coefficients()
    X = roll_out(np.concatenate([X0, U[0]]), U, C, np.full(stages, 0.3), p)
    X[1:] += gap * rng.normal(size=(stages, 8)) * [1.0, 1.0, 0.3, 0.3, 1.0, 0.3, 30.0, 30.0]
    return linearise(X, U, C, 0.3, p), np.vstack([np.tile(rng.normal(size=2), (stages, 1)), rng.normal(size=2) * 0.1])


def unlike_any_motion(seed: int, stages: int) -> tuple[Linearisation, Array]:
    """Sensitivities without structure but for the documented one, and gaps; and a target that moves."""
    rng = np.random.default_rng(seed)
    A, B0, B1 = (rng.normal(size=(stages, 8, k)) * 0.3 for k in (8, 2, 2))
    A[:, :, :2] = A[:, 6:, :] = 0.0
    A[:, range(8), range(8)] = rng.uniform(0.3, 0.8, (stages, 8))
    A[:, range(2), range(2)] = 1.0
    for B in (B0, B1):
        B /= LIMITS.thrust_scale
        B[:, 6, 1] = B[:, 7, 0] = 0.0
    X = rng.normal(size=(stages + 1, 8))
    U = rng.uniform(-40, 40, (stages + 1, 2))
    lin = Linearisation(X, U, rng.normal(size=(stages + 1, 2)), X[1:] + rng.normal(size=(stages, 8)) * 0.1, A, B0, B1)
    return lin, rng.normal(size=(stages + 1, 2))


class Form(NamedTuple):
    """Knots, limits and weights of a problem."""

    knots: Array
    limits: Constants = LIMITS
    weights: Weights = Weights()

    @property
    def constants(self) -> Constants:
        """Constants of a cycle with this problem."""
        return self.limits._replace(t=self.knots, weights=np.array(astuple(self.weights)))

    def problem(self, lin: Linearisation, target: Array, rows: Array | None = None) -> Problem:
        """Return the problem along a motion; ``rows`` (N, M, 4): normal of dp over the scale, bound and penalty."""
        plain = problem_along(lin, target, self.constants)
        return plain if rows is None else with_rows(plain, rows, self.limits)

    def commands(self, lin: Linearisation, z: Array) -> Array:
        """Return the commands (N+1, 2) of a solution."""
        return lin.U + z[:, COMMANDS:CHANGES] * self.limits.thrust_scale

    def optimum(self, lin: Linearisation, target: Array, rows: Array | None = None) -> Array:
        """Return the commands (N+1, 2) of the optimum."""
        problem = self.problem(lin, target, rows)
        return self.commands(lin, solution_of(problem, precise(sparse_qp(problem))))


def with_rows(plain: Problem, rows: Array, limits: Constants) -> Problem:
    """Return a problem with half-planes in addition."""
    N, n, m, M = plain.sizes
    p = Problem.empty(N, n, m, M + rows.shape[1])
    for to, part in zip(p[:4], plain[:4], strict=True):
        to[...] = part
    for to, part in zip(p[4:], plain[4:], strict=True):
        to[:, :M] = part
    p.G[1:, M:, :2] = rows[:, :, :2] * limits.state_scale[:2]
    p.low[1:, M:], p.penalty[1:, M:] = rows[:, :, 2], rows[:, :, 3]
    return p


def precise(qp: QP) -> Array:
    """Return the optimum x (n,) by an interior-point method, to about 1e-12; where that fails, by an active-set one."""
    rows, equal = csc_matrix(qp.A), qp.l == qp.u
    solver = piqp.SparseSolver()
    solver.settings.eps_abs = solver.settings.eps_rel = 1e-13
    solver.settings.eps_duality_gap_abs = solver.settings.eps_duality_gap_rel = 1e-14
    solver.setup(csc_matrix(qp.P), qp.q, rows[equal], qp.l[equal], rows[~equal], qp.l[~equal], qp.u[~equal])
    if solver.solve() != piqp.Status.PIQP_SOLVED:
        other = solve_qp(qp, "daqp")
        if other.solve.status is SolveStatus.SOLVED:
            return other.x
    return np.array(solver.result.x)


class Answer(NamedTuple):
    """Commands of a solve, and the solver's report."""

    commands: Array
    solve: Solve


def answer(
    solver: Solver,
    form: Form,
    lin: Linearisation,
    target: Array,
    stages: float = math.nan,
    *,
    rows: Array | None = None,
) -> Answer:
    """Return the answer to a cycle ``stages`` first stages after the last one; NaN: there was none."""
    result = solver.solve(form.problem(lin, target, rows), stages)
    return Answer(form.commands(lin, result.z), result.solve)
