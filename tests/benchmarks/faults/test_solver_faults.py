"""Trouble in the solver comes from outside of the controller, in its spell alone."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.faults.effects import (
    FaultySolver,
    InjectedSolverError,
    Interval,
    SolverClock,
    SolverFault,
    SolverFaultInterval,
    faulty_solvers,
)
from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.control.solvers import make
from ltv_mpc.control.solvers.interface import Result
from ltv_mpc.messages import Solve, SolveStatus
from ltv_mpc.vehicle.parameters import Vehicle

INTERVAL = Interval(100, 200)
GOOD = Result(np.ones((3, 2)), Solve(status=SolveStatus.SOLVED))


class Good:
    def solve(self) -> Result:
        return GOOD

    def reset_warm_start(self) -> str:
        return "forgotten"


def answer(fault: SolverFault, t_ns: int) -> Result:
    now = SolverClock()
    now.t_ns = t_ns
    return FaultySolver(Good(), [SolverFaultInterval(fault, INTERVAL)], now).solve()


@pytest.mark.parametrize("fault", SolverFault)
@pytest.mark.parametrize("t_ns", [99, 200])
def test_outside_its_spell_the_answer_is_the_solvers_own(fault, t_ns):
    assert answer(fault, t_ns) is GOOD


def test_in_its_spell_there_is_no_finite_command():
    for fault, status in ((SolverFault.FAILS, SolveStatus.FAILED), (SolverFault.LIES, SolveStatus.SOLVED)):
        z, solve = answer(fault, 150)
        assert np.isnan(z).all()
        assert solve.status is status
    with pytest.raises(InjectedSolverError):
        answer(SolverFault.RAISES, 150)


def test_the_factory_wraps_the_solver_that_the_settings_name():
    factory = faulty_solvers([SolverFaultInterval(SolverFault.FAILS, INTERVAL)], SolverClock())
    settings = Vehicle.load("paper"), ControllerConfig(solver="riccati")
    solver = factory(*settings)
    assert isinstance(solver, FaultySolver)
    assert solver.build.__func__ is type(make(*settings)).build  # everything else is the solver's own
