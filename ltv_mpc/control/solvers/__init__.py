"""Solvers: each takes the cycle's QP and returns a ``Solution``; none ever raises for a problem it cannot solve."""

from __future__ import annotations

from typing import Protocol

from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.control.qp.problem import QP, Solution
from ltv_mpc.control.solvers.by_name import ByName, known_solvers
from ltv_mpc.control.solvers.osqp import Osqp
from ltv_mpc.errors import ConfigError
from ltv_mpc.signals import Array


class Solver(Protocol):
    """Keeps what it needs from cycle to cycle; the pattern of P and A never changes."""

    def solve(self, qp: QP, warm_x: Array, warm_y: Array) -> Solution:
        """Solve from a first guess of primal (n,) and dual (m,)."""
        ...


def make(config: ControllerConfig) -> Solver:
    """The solver that ``config`` names. Raises ``ConfigError`` for an unknown one, naming those that are known."""
    if config.solver == "osqp":
        return Osqp(config.max_iterations, config.tolerance)
    if config.solver in known_solvers():
        return ByName(config.solver)
    raise ConfigError(
        "controller settings",
        "solver",
        f"not installed or not known; installed: {', '.join(sorted({'osqp', *known_solvers()}))}",
        value=config.solver,
    )


def solve_qp(qp: QP, solver: str = "osqp") -> Solution:
    """Solve one QP from nothing with any installed solver by name. Raises ``ConfigError`` for an unknown name."""
    import numpy as np

    return make(ControllerConfig(solver=solver, max_iterations=20_000, tolerance=1e-9)).solve(
        qp, np.zeros(len(qp.q)), np.zeros(len(qp.l))
    )


__all__ = ["Solver", "make", "solve_qp"]
