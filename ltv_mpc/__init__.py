"""LTV-MPC of an underactuated AUV in a water current: the software that runs aboard.

This package imports neither the simulation nor the services. Its modules are imported when a name is first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ltv_mpc import references
    from ltv_mpc.bathymetry import Bathymetry
    from ltv_mpc.control.config import ControllerConfig
    from ltv_mpc.control.controller import Controller
    from ltv_mpc.control.nominal_model import advance
    from ltv_mpc.control.ocp.extension import Limit, Motion, Term
    from ltv_mpc.control.solvers import solve_qp
    from ltv_mpc.control.solvers.sparse import build_qp
    from ltv_mpc.geofence.fence import Fence
    from ltv_mpc.messages import CurrentProfile, Estimate, Obstacle, Obstacles, Plan, PlanOrigin, SolveStatus
    from ltv_mpc.vehicle.parameters import Vehicle

_HOME = {
    "Bathymetry": "ltv_mpc.bathymetry",
    "Controller": "ltv_mpc.control.controller",
    "ControllerConfig": "ltv_mpc.control.config",
    "CurrentProfile": "ltv_mpc.messages",
    "Estimate": "ltv_mpc.messages",
    "Fence": "ltv_mpc.geofence.fence",
    "Limit": "ltv_mpc.control.ocp.extension",
    "Motion": "ltv_mpc.control.ocp.extension",
    "Obstacle": "ltv_mpc.messages",
    "Obstacles": "ltv_mpc.messages",
    "Plan": "ltv_mpc.messages",
    "PlanOrigin": "ltv_mpc.messages",
    "SolveStatus": "ltv_mpc.messages",
    "Term": "ltv_mpc.control.ocp.extension",
    "Vehicle": "ltv_mpc.vehicle.parameters",
    "advance": "ltv_mpc.control.nominal_model",
    "build_qp": "ltv_mpc.control.solvers.sparse",
    "references": "ltv_mpc.references",
    "solve_qp": "ltv_mpc.control.solvers",
}

__all__ = [
    "Bathymetry",
    "Controller",
    "ControllerConfig",
    "CurrentProfile",
    "Estimate",
    "Fence",
    "Limit",
    "Motion",
    "Obstacle",
    "Obstacles",
    "Plan",
    "PlanOrigin",
    "SolveStatus",
    "Term",
    "Vehicle",
    "advance",
    "build_qp",
    "references",
    "solve_qp",
]


def __getattr__(name: str) -> object:
    """Import a public name at its first use."""
    if name not in _HOME:
        raise AttributeError(f"module 'ltv_mpc' has no attribute {name!r}")
    if name == "references":
        return import_module(_HOME[name])
    return getattr(import_module(_HOME[name]), name)
