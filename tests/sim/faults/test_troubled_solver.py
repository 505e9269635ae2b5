"""Trouble in the solver comes from outside of the controller, in its spell alone."""

from __future__ import annotations

import numpy as np
import pytest

from ltv_mpc.control import controller
from ltv_mpc.control.solvers.interface import SolverResult
from ltv_mpc.messages import Solve, SolveStatus
from sim.faults.interval import Spell
from sim.faults.solver import Now, SolverRaised, Trouble, Troubled, TroubledSolver, troubled

SPELL = Spell(100, 200)
GOOD = SolverResult(np.ones((3, 2)), Solve(status=SolveStatus.SOLVED))


class Good:
    def solve(self) -> SolverResult:
        return GOOD

    def reset_warm_start(self) -> str:
        return "forgotten"


def answer(trouble: Trouble, t_ns: int) -> SolverResult:
    now = Now()
    now.t_ns = t_ns
    return TroubledSolver(Good(), [Troubled(trouble, SPELL)], now).solve()


@pytest.mark.parametrize("trouble", Trouble)
@pytest.mark.parametrize("t_ns", [99, 200])
def test_outside_its_spell_the_answer_is_the_solvers_own(trouble, t_ns):
    assert answer(trouble, t_ns) is GOOD


def test_in_its_spell_there_is_no_finite_command():
    for trouble, status in ((Trouble.FAILS, SolveStatus.FAILED), (Trouble.LIES, SolveStatus.SOLVED)):
        commands, solve = answer(trouble, 150)
        assert np.isnan(commands).all()
        assert solve.status is status
    with pytest.raises(SolverRaised):
        answer(Trouble.RAISES, 150)


def test_solvers_made_while_it_lasts_are_in_trouble_and_those_made_after_are_not(monkeypatch):
    monkeypatch.setattr(controller, "make", lambda *_: Good())
    with troubled([Troubled(Trouble.FAILS, SPELL)], Now()):
        made = controller.make("vehicle", "config")
        assert isinstance(made, TroubledSolver)
        assert made.reset_warm_start() == "forgotten"
    assert isinstance(controller.make("vehicle", "config"), Good)
