"""Solvers of the controller's QP, by name; docs/add-solver.md shows how to add one."""

from __future__ import annotations

import functools
from collections.abc import Callable

from ltv_mpc.control.config import ControllerConfig, ResolvedConfig
from ltv_mpc.control.resolution import settled
from ltv_mpc.control.solvers.interface import Result, Solver
from ltv_mpc.control.solvers.osqp import OsqpSolver
from ltv_mpc.control.solvers.qpsolvers_backend import QpsolversBackend, installed_backends, solve_qp
from ltv_mpc.errors import SolverNotInstalled
from ltv_mpc.vehicle.parameters import Vehicle

SOLVERS: dict[str, Callable[[ResolvedConfig], Solver]] = {
    "osqp": OsqpSolver,
    "riccati": functools.partial(OsqpSolver, confirms=False),
}
"""Solvers of this project by name, which keep their workspace between cycles. Other names are backends of qpsolvers."""


SolverFactory = Callable[[Vehicle, ControllerConfig], Solver]
"""Makes a solver for one vehicle and its settings; ``make`` is the default one."""


def make(vehicle: Vehicle, config: ControllerConfig) -> Solver:
    """Return the solver that the settings name.

    Parameters
    ----------
    vehicle : gives what the settings leave out.
    config : settings of the controller; ``config.solver`` is the name.

    Returns
    -------
    A new solver, without a warm start.

    Raises
    ------
    SolverNotInstalled
        The solver is not known or not installed. It is a ``ConfigError``.
    """
    config = settled(config, vehicle)
    if config.solver in SOLVERS:
        return SOLVERS[config.solver](config)
    installed = installed_backends()
    if config.solver not in installed:
        known = dict.fromkeys((*SOLVERS, *installed))
        problem = f"is not installed or not known; installed: {', '.join(known)}"
        raise SolverNotInstalled("controller settings", "solver", problem, value=config.solver)
    return QpsolversBackend(config)


__all__ = ["Result", "Solver", "SolverFactory", "make", "solve_qp"]
