"""Base of all peers: a solver of the controller that takes a linearisation and finds commands at the knots.

A solver is given the problem alone (ltv_mpc/control/ocp/problem.py). Every controller that is made after the import of
this file keeps the trajectory that it linearises along, and the target. Peers that solve the nonlinear problem take
from it only what it was taken along: the state at the start, the command in force, the current, and the commands to
start from.
"""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from ltv_mpc.control import controller
from ltv_mpc.control.config import ResolvedConfig
from ltv_mpc.control.lateral import LateralPlanner
from ltv_mpc.control.linearisation import Linearisation
from ltv_mpc.control.ocp.problem import Problem, roll_out
from ltv_mpc.control.problem_data import CHANGES, Constants
from ltv_mpc.control.solvers.interface import Result
from ltv_mpc.messages import Array, Solve, SolveStatus
from ltv_mpc.vehicle.parameters import Vehicle

_now: list[tuple[Linearisation, Array, Array]] = []
"""What the QP that is being solved was made from; the next cycle overwrites it."""


class _Planner(LateralPlanner):
    """The controller's planner."""

    def _run_solver(self, problem: Problem, shift: float, *, last: bool) -> Result:
        _now[:] = [(self._cycle.lin, self._cycle.target[:, :2], self._cycle.constants.p)]
        return super()._run_solver(problem, shift, last=last)


controller.LateralPlanner = _Planner  # type: ignore[attr-defined]


class Peer:
    """``solves`` says which problem: ``QP`` is the controller's own, ``NLP`` the nonlinear one behind it."""

    name: ClassVar[str]
    solves: ClassVar[str]
    settings: ClassVar[str]  # what differs from the tool's defaults, and why

    def __init__(self, config: ResolvedConfig, limits: Constants, vehicle: Vehicle) -> None:
        self.stages, self.knots = config.stages, config.knots
        self.weights = config.weights
        self.limits = limits
        self.vehicle = vehicle

    @property
    def lin(self) -> Linearisation:
        """The motion that the problem was made along."""
        return _now[0][0]

    @property
    def reference(self) -> Array:
        """Positions (N, 2) wanted; what is held is a point, so no velocity is wanted at the end."""
        return _now[0][1][:-1]

    @property
    def coefficients(self) -> Array:
        """Coefficients of the vehicle, with what the controller has learned."""
        return _now[0][2]

    def box(self) -> tuple[Array, Array]:
        """Lower and upper bounds of the commands at the knots 1 .. N, (N, 2) each (N); a start outside returns."""
        start, reach = self.lin.U[0], self.knots[1:, None] * self.limits.max_change
        return np.minimum(self.limits.low, start + reach), np.maximum(self.limits.high, start - reach)

    def shift_warm_start(self, stages: float) -> None:
        """Shift the warm start by this number of stages."""

    def reset_warm_start(self) -> None:
        """Reset the warm start."""

    def set_up(self, problem: Problem) -> None:
        """Nothing: peers set up in their constructor."""

    def solve(self, problem: Problem, shift: float, *, last: bool = True) -> Result:  # noqa: ARG002
        """Solve a problem of the controller (see ``Solver``)."""
        self.problem = problem
        if math.isnan(shift):
            self.reset_warm_start()
        elif shift != 0.0:
            self.shift_warm_start(shift)
        return self.find()

    def find(self) -> Result:
        """Solve the present problem."""
        raise NotImplementedError

    def answer(self, following: Array | None, *, iterations: int = 0, why: str = "") -> Result:
        """Return the solution of commands after the first (N, 2); None: no solution, for the reason ``why``."""
        if following is None or not np.isfinite(following).all():
            solve = Solve(status=SolveStatus.FAILED, iterations=iterations, why=why or "not finite")
            return Result(np.zeros_like(self.problem.h), solve)
        commands = np.vstack([self.lin.U[:1], following])
        z = np.zeros_like(self.problem.h)
        z[:-1, CHANGES:] = np.diff((commands - self.lin.U) / self.limits.thrust_scale, axis=0)
        roll_out(self.problem, z)
        return Result(z, Solve(status=SolveStatus.SOLVED, iterations=iterations))
