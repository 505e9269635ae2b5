"""What the controller's QP is made from, for tools that solve the nonlinear problem behind it.

A solver is given the problem alone (ltv_mpc/control/ocp/problem.py). Every controller that is made after the import of
this file keeps the trajectory that it linearises along, and the target, where ``now`` finds them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ltv_mpc.control import controller
from ltv_mpc.control.horizon_limits import HorizonLimits
from ltv_mpc.control.lateral import LateralPlanner
from ltv_mpc.control.linearisation import Linearisation
from ltv_mpc.control.ocp.problem import Problem, roll_out
from ltv_mpc.control.problem_data import CHANGES
from ltv_mpc.control.solvers.interface import Result
from ltv_mpc.messages import Array


class Along(NamedTuple):
    """Nominal trajectory and target of a QP."""

    lin: Linearisation
    target: Array  # (N+1, 2) positions, and the velocity over ground at the end


_now: list[Along] = []


def now() -> Along:
    """Return what the QP that is being solved was made from; the next cycle overwrites it."""
    return _now[0]


def is_at(lin: Linearisation, target: Array) -> None:
    """Set what ``now`` returns."""
    _now[:] = [Along(lin, target[:, :2])]


class _Planner(LateralPlanner):
    """The controller's planner."""

    def _run_solver(self, problem: Problem, shift: float, *, last: bool) -> Result:
        is_at(self._cycle.lin, self._cycle.target)
        return super()._run_solver(problem, shift, last=last)


controller.LateralPlanner = _Planner  # type: ignore[misc]


def solution(problem: Problem, commands: Array, nominal: Array, limits: HorizonLimits) -> Array:
    """Return states and inputs (N+1, 12) of a problem that commands lead to.

    Parameters
    ----------
    problem : problem.
    commands, nominal : (N+1, 2) commands, and those that it is linearised along (N).
    limits : has the scale of the thrust.
    """
    z = np.zeros_like(problem.h)
    z[:-1, CHANGES:] = np.diff((commands - nominal) / limits.thrust_scale, axis=0)
    roll_out(problem, z)
    return z
