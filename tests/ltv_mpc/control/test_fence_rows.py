"""Half-planes of the fence in the QP: every solver has the same optimum, and the penalty is exact."""

from __future__ import annotations

import numpy as np
import pytest

from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.control.fence_rows import PENALTY
from ltv_mpc.control.horizon_limits import NO_BOUND, HorizonLimits
from ltv_mpc.control.linearisation import Linearisation
from ltv_mpc.control.qp.sparse import SparseQp
from ltv_mpc.control.resolution import settled
from ltv_mpc.control.solvers import Solver, make
from ltv_mpc.messages import Array, SolveStatus
from tests.ltv_mpc.control.problems import PAPER, SOLVER_NAMES, equidistant, motion, precise

N, M = 17, 3


def settings(solver: str = "osqp") -> ControllerConfig:
    return ControllerConfig(max_iterations=4000, horizon_s=N * 0.3, solver=solver)


def problem(seed: int, distance: float) -> tuple[Linearisation, Array]:
    """Return a problem with a wall between its nominal end and its target, and one row that is not used."""
    free, target = motion(seed, N)
    lin = Linearisation.from_arrays(*free[:-2], np.empty((N, M, 4)))
    rng = np.random.default_rng(seed)
    away = lin.X[N, :2] - target[N - 1]
    angle = np.arctan2(away[1], away[0])
    for j in range(2):
        m = np.array([np.cos(angle), np.sin(angle)])
        angle += rng.uniform(-0.8, 0.8)
        wall = m @ lin.X[N, :2] - distance * (j + 1)
        lin.rows[:, j, :2] = m
        lin.rows[:, j, 2] = wall - lin.X[1:, :2] @ m
    lin.rows[:, 2] = 0.0
    lin.rows[:, 2, 2] = -NO_BOUND
    lin.rows[:, :, 3] = PENALTY
    return lin, target


def form() -> SparseQp:
    config = settled(settings(), PAPER)
    return SparseQp(equidistant(N), HorizonLimits.from_vehicle(PAPER, 0.3), config.weights)


@pytest.mark.parametrize("solver", SOLVER_NAMES)
def test_every_solver_has_them(solver: str) -> None:
    of, active = form(), 0
    for seed in range(8):
        lin, target = problem(seed, 0.05)
        made: Solver = make(PAPER, settings(solver))
        made.build(lin, target)
        made.update()
        commands, solve = made.solve()
        x = precise(of.build(lin, target))
        assert solve.status is SolveStatus.SOLVED, solve.why
        np.testing.assert_allclose(commands, of.commands(lin, x), atol=0.1)
        free = SparseQp(equidistant(N), of.limits, of.weights)
        without = Linearisation.from_arrays(*lin[:-2])
        active += bool(
            np.abs(of.commands(lin, x) - free.commands(without, precise(free.build(without, target)))).max() > 1.0
        )
    assert active >= 4
