"""Base of all peers: a solver of the controller that takes a linearisation and finds commands at the knots.

Peers that solve the nonlinear problem take from the linearisation only what it was taken along: the state at the start,
the command in force, the current, and the commands to start from.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from benchmarks import along
from ltv_mpc.control.config import ResolvedConfig
from ltv_mpc.control.horizon_limits import HorizonLimits
from ltv_mpc.control.linearisation import Linearisation
from ltv_mpc.control.ocp.problem import Problem
from ltv_mpc.control.solvers.interface import Result
from ltv_mpc.messages import Array, Solve, SolveStatus
from ltv_mpc.vehicle.parameters import Vehicle


class Peer:
    """``solves`` says which problem: ``QP`` is the controller's own, ``NLP`` the nonlinear one behind it."""

    name: ClassVar[str]
    solves: ClassVar[str]
    packages: ClassVar[tuple[str, ...]]
    settings: ClassVar[str]  # what differs from the tool's defaults, and why

    def __init__(self, config: ResolvedConfig, limits: HorizonLimits, vehicle: Vehicle) -> None:
        self.stages, self.knots = config.stages, config.knots
        self.weights = config.weights
        self.limits = limits
        self.vehicle = vehicle

    @property
    def lin(self) -> Linearisation:
        """The motion that the problem was made along."""
        return along.now().lin

    @property
    def reference(self) -> Array:
        """Positions (N, 2) wanted; what is held is a point, so no velocity is wanted at the end."""
        return along.now().target[:-1]

    def shift_warm_start(self, stages: float) -> None:
        """Shift the warm start by this number of stages."""

    def reset_warm_start(self) -> None:
        """Reset the warm start."""

    def build(self, problem: Problem) -> None:
        """Keep the problem."""
        self.problem = problem

    def update(self) -> None:
        """Nothing: peers set up and solve in one."""

    def solve(self) -> Result:
        """Solve what was built."""
        raise NotImplementedError

    def answer(self, following: Array | None, *, iterations: int = 0, why: str = "") -> Result:
        """Return the solution of commands after the first (N, 2); None: no solution, for the reason ``why``."""
        if following is None or not np.isfinite(following).all():
            solve = Solve(status=SolveStatus.FAILED, iterations=iterations, why=why or "not finite")
            return Result(np.zeros_like(self.problem.h), solve)
        commands = np.vstack([self.lin.U[:1], following])
        z = along.solution(self.problem, commands, self.lin.U, self.limits)
        return Result(z, Solve(status=SolveStatus.SOLVED, iterations=iterations))
