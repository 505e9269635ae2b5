"""Solvers: each takes a cycle's linearisation and returns commands; none ever raises for a problem it cannot solve."""

from __future__ import annotations

from ltv_mpc.control.config import STAGE_NS, ControllerConfig
from ltv_mpc.control.horizon_limits import HorizonLimits
from ltv_mpc.control.scaling import resolve_weights
from ltv_mpc.control.solvers.interface import Solver, SolverResult
from ltv_mpc.control.solvers.osqp import OsqpSolver
from ltv_mpc.control.solvers.qpsolvers_backend import QpsolversBackend, known_solvers, solve_qp
from ltv_mpc.control.solvers.riccati_solver import RiccatiSolver
from ltv_mpc.errors import ConfigError
from ltv_mpc.vehicle.parameters import Vehicle

OSQP, RICCATI = "osqp", "riccati"
"""The solvers of this project, which keep their workspace from cycle to cycle. Every other name is one of qpsolvers."""


def make(vehicle: Vehicle, config: ControllerConfig) -> Solver:
    """Return the solver that ``config`` names. Raises ``ConfigError`` if it is unknown or cannot solve the problem."""
    config = resolve_weights(config, vehicle)
    limits = HorizonLimits.from_vehicle(vehicle, STAGE_NS * 1e-9, config.limits.max_abs)
    if config.solver == OSQP:
        return OsqpSolver(config, limits)
    if config.solver == RICCATI:
        if limits.limited:
            problem = "does not support motion limits: use osqp or a solver of qpsolvers"
            raise ConfigError("controller settings", "solver", problem, value=config.solver)
        return RiccatiSolver(config, limits)
    known = (RICCATI, *known_solvers())
    if config.solver not in known:
        problem = f"is not installed or not known; installed: {', '.join(known)}"
        raise ConfigError("controller settings", "solver", problem, value=config.solver)
    return QpsolversBackend(config, limits)


__all__ = ["Solver", "SolverResult", "make", "solve_qp"]
