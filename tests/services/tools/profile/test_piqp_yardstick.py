"""PIQP by its own interface: the optimum, cycle after cycle, and as good after a failure as before."""

from __future__ import annotations

import numpy as np
import pytest

from ltv_mpc.control.config import ResolvedConfig, Weights
from ltv_mpc.control.horizon_limits import HorizonLimits
from ltv_mpc.control.qp.sparse import SparseQp
from ltv_mpc.control.solvers import solve_qp
from ltv_mpc.messages import SolveStatus
from services.tools.profile.piqp_yardstick import PiqpYardstick
from tests.ltv_mpc.control.problems import LIMITS, LOWERED, PAPER, motion, solved

CONFIG = ResolvedConfig(horizon_s=5.0, weights=Weights())
TURNS_SLOWLY = HorizonLimits.from_vehicle(PAPER, 0.3, np.array([[-np.inf, -0.15], [np.inf, 0.15]]))


@pytest.mark.parametrize("limits", [LIMITS, LOWERED, TURNS_SLOWLY], ids=["box", "lowered box", "yaw rate"])
def test_its_commands_are_those_of_an_active_set_method(limits: HorizonLimits) -> None:
    solver, form = PiqpYardstick(CONFIG, limits, 1e-11), SparseQp(CONFIG.knots, limits, CONFIG.weights)
    for seed in range(4):  # the second and later ones update the first one's workspace
        lin, target = motion(seed, CONFIG.stages, gap=0.02)
        ours = solved(solver, lin, target)
        theirs = form.commands(lin, solve_qp(form.build(lin, target), "daqp").x)
        assert ours.solve.status is SolveStatus.SOLVED
        np.testing.assert_array_equal(ours.commands[0], lin.U[0])
        np.testing.assert_allclose(ours.commands, theirs, atol=1e-3)


def test_a_problem_that_is_not_finite_is_reported_and_leaves_nothing_behind() -> None:
    solver = PiqpYardstick(CONFIG, LIMITS)
    lin, target = motion(2, CONFIG.stages)
    expected = solved(solver, lin, target)
    failed = solved(solver, lin, np.full_like(target, np.nan))
    assert failed.solve.status is SolveStatus.NON_FINITE
    np.testing.assert_array_equal(failed.commands, lin.U)
    # Not to the last bit: PIQP's sums depend on where its arrays lie in memory.
    np.testing.assert_allclose(solved(solver, lin, target).commands, expected.commands, rtol=0, atol=1e-5)
