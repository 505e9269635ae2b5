"""Problems for every solver, and their optimum by a solver that shares nothing with them."""

from __future__ import annotations

import math

import numpy as np
import piqp
from scipy.sparse import csc_matrix

from ltv_mpc.control.config import Weights
from ltv_mpc.control.horizon_limits import HorizonLimits
from ltv_mpc.control.linearisation import Linearisation, linearise, roll_out
from ltv_mpc.control.qp.problem import QP
from ltv_mpc.control.qp.sparse import SparseQp
from ltv_mpc.control.solvers import SOLVERS, Solver, SolverResult
from ltv_mpc.messages import Array
from ltv_mpc.vehicle.parameters import Vehicle

PAPER = Vehicle.load("paper")

SOLVER_NAMES = (*SOLVERS, "piqp", "daqp")
"""Every solver of the table, and two backends of qpsolvers: an interior-point and an active-set method."""

LIMITS = HorizonLimits.from_vehicle(PAPER, 0.3)
LOWERED = HorizonLimits(0.4 * LIMITS.low, np.array([0.4, 0.3]) * LIMITS.high, LIMITS.max_change, LIMITS.state_scale)
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
    lin = Linearisation.from_arrays(
        X, U, rng.normal(size=(stages + 1, 2)), X[1:] + rng.normal(size=(stages, 8)) * 0.1, A, B0, B1
    )
    return lin, rng.normal(size=(stages + 1, 2))


def precise(qp: QP) -> Array:
    """Return the optimum x (n,) by an interior-point method, to about 1e-12."""
    rows, equal = csc_matrix(qp.A), qp.l == qp.u
    solver = piqp.SparseSolver()
    solver.settings.eps_abs = solver.settings.eps_rel = 1e-13
    solver.settings.eps_duality_gap_abs = solver.settings.eps_duality_gap_rel = 1e-14
    solver.setup(csc_matrix(qp.P), qp.q, rows[equal], qp.l[equal], rows[~equal], qp.l[~equal], qp.u[~equal])
    solver.solve()
    return np.array(solver.result.x)


def solved(solver: Solver, lin: Linearisation, target: Array) -> SolverResult:
    """Return the result of a cycle, from the solver's present warm start."""
    solver.build(lin, target)
    solver.update()
    return solver.solve()


def answer(solver: Solver, lin: Linearisation, target: Array, stages: float = math.nan) -> SolverResult:
    """Return the result of a cycle ``stages`` first stages after the last one; NaN: there was none."""
    if math.isnan(stages):
        solver.reset_warm_start()
    else:
        solver.shift_warm_start(stages)
    return solved(solver, lin, target)


def optimum(
    lin: Linearisation, target: Array, limits: HorizonLimits, weights: Weights, knots: Array | None = None
) -> Array:
    """Commands (N+1, 2) of the sparse QP's optimum; the knots are equidistant if none are given."""
    form = SparseQp(equidistant(len(lin.U) - 1) if knots is None else knots, limits, weights)
    return form.commands(lin, precise(form.build(lin, target)))
