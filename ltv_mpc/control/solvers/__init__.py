"""Solvers of the controller's QP, by name; docs/add-solver.md shows how to add one."""

from __future__ import annotations

from collections.abc import Callable

from ltv_mpc.control.config import STAGE_NS, ControllerConfig, ResolvedConfig
from ltv_mpc.control.horizon_limits import HorizonLimits
from ltv_mpc.control.resolution import settled
from ltv_mpc.control.solvers.interface import Solver, SolverResult
from ltv_mpc.control.solvers.osqp import OsqpSolver
from ltv_mpc.control.solvers.qpsolvers_backend import QpsolversBackend, installed_backends, solve_qp
from ltv_mpc.control.solvers.riccati_solver import RiccatiSolver
from ltv_mpc.errors import ConfigError
from ltv_mpc.vehicle.parameters import Vehicle


def _checked_riccati(config: ResolvedConfig, limits: HorizonLimits) -> Solver:
    """Return the Riccati solver; OSQP solves what it does not solve."""
    return RiccatiSolver(config, limits, OsqpSolver(config, limits))


SOLVERS: dict[str, Callable[[ResolvedConfig, HorizonLimits], Solver]] = {
    "osqp": OsqpSolver,
    "riccati": _checked_riccati,
}
"""Solvers of this project by name, which keep their workspace between cycles. Other names are backends of qpsolvers."""


SolverFactory = Callable[[Vehicle, ControllerConfig], Solver]
"""Makes a solver for one vehicle and its settings; ``make`` is the default one."""


def make(vehicle: Vehicle, config: ControllerConfig) -> Solver:
    """Return the solver that the settings name.

    Parameters
    ----------
    vehicle : gives limits and scales.
    config : settings of the controller; ``config.solver`` is the name.

    Returns
    -------
    A new solver, without a warm start.

    Raises
    ------
    ConfigError
        The solver is not known or not installed, or it cannot take limits of the motion.
    """
    config = settled(config, vehicle)
    limits = HorizonLimits.from_vehicle(vehicle, STAGE_NS * 1e-9, config.limits.state_bounds)
    if config.solver in SOLVERS:
        return SOLVERS[config.solver](config, limits)
    installed = installed_backends()
    if config.solver not in installed:
        known = dict.fromkeys((*SOLVERS, *installed))
        problem = f"is not installed or not known; installed: {', '.join(known)}"
        raise ConfigError("controller settings", "solver", problem, value=config.solver)
    return QpsolversBackend(config, limits)


__all__ = ["Solver", "SolverFactory", "SolverResult", "make", "solve_qp"]
