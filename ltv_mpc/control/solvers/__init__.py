"""Solvers: each takes a cycle's linearisation and returns commands; none ever raises for a problem it cannot solve."""

from __future__ import annotations

from collections.abc import Callable

from ltv_mpc.control.config import STAGE_NS, ControllerConfig, Formulation, MotionLimits, SettledConfig
from ltv_mpc.control.limits import HorizonLimits
from ltv_mpc.control.scales import settled
from ltv_mpc.control.solvers.by_name import ByName, known_solvers, solve_qp
from ltv_mpc.control.solvers.daqp import CondensedDaqp
from ltv_mpc.control.solvers.partial_osqp import PartialOsqp
from ltv_mpc.control.solvers.solver import Answer, Solver
from ltv_mpc.control.solvers.sparse_osqp import SparseOsqp
from ltv_mpc.control.solvers.sparse_piqp import SparsePiqp
from ltv_mpc.control.solvers.stagewise import Stagewise
from ltv_mpc.errors import ConfigError
from ltv_mpc.vehicle.parameters import Vehicle

OWN = "riccati"
"""What needs no package."""

NATIVE: dict[tuple[str, Formulation], Callable[[SettledConfig, HorizonLimits], Solver]] = {
    ("osqp", "sparse"): SparseOsqp,
    ("osqp", "partial"): PartialOsqp,
    ("daqp", "condensed"): CondensedDaqp,
    ("piqp", "sparse"): SparsePiqp,
    (OWN, "sparse"): Stagewise,
}
"""By their own interfaces, updated in place. Every other solver goes through qpsolvers, on the sparse form."""


def make(vehicle: Vehicle, config: ControllerConfig) -> Solver:
    """The solver that ``config`` names. Raises ``ConfigError`` for one that is not there or has no such formulation."""
    config = settled(config, vehicle)
    limits = HorizonLimits.of(vehicle, STAGE_NS * 1e-9, config.limits.most)
    formulation = chosen(config)
    if formulation != "sparse" and limits.limited:
        raise ConfigError(
            "controller settings", "formulation", "must be sparse with limits of the motion", value=config.formulation
        )
    if config.solver == OWN and limits.limited:
        raise ConfigError(
            "controller settings", "solver", "cannot do limits of the motion; osqp, piqp can", value=config.solver
        )
    native = NATIVE.get((config.solver, formulation))
    if native is not None:
        return native(config, limits)
    known = (OWN, *known_solvers())
    if config.solver not in known:
        raise ConfigError(
            "controller settings",
            "solver",
            f"not installed or not known; installed: {', '.join(known)}",
            value=config.solver,
        )
    if formulation != "sparse":
        there = sorted({form for name, form in NATIVE if name == config.solver} | {"sparse"})
        raise ConfigError(
            "controller settings",
            "formulation",
            f"not there for solver {config.solver}, which has: {', '.join(there)}",
            value=formulation,
        )
    return ByName(config, limits)


FASTEST: dict[str, Formulation] = {"osqp": "partial", "daqp": "condensed"}
"""By ``ltv-mpc profile``, its table in docs/control.md."""


def chosen(config: ControllerConfig) -> Formulation:
    """What ``auto`` stands for."""
    if config.formulation != "auto":
        return config.formulation
    if config.limits != MotionLimits():  # of the sparse form alone
        return "sparse"
    return FASTEST.get(config.solver, "sparse")


__all__ = ["NATIVE", "Answer", "Solver", "chosen", "make", "solve_qp"]
