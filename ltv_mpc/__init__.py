"""LTV-MPC of an underactuated AUV in a water current: the software that runs aboard.

This package imports neither the simulation nor the services. Its modules are imported when a name is first used. Two
names are for a user alone and import both at their first use: ``simulate`` and ``Run``; nothing aboard uses them.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ltv_mpc import references as references
    from ltv_mpc.bathymetry import Bathymetry as Bathymetry
    from ltv_mpc.control.config import ControllerConfig as ControllerConfig
    from ltv_mpc.control.controller import Controller as Controller
    from ltv_mpc.control.nominal_model import advance as advance
    from ltv_mpc.control.ocp.extension import Limit as Limit
    from ltv_mpc.control.ocp.extension import Motion as Motion
    from ltv_mpc.control.ocp.extension import Term as Term
    from ltv_mpc.control.solvers import solve_qp as solve_qp
    from ltv_mpc.control.solvers.sparse import build_qp as build_qp
    from ltv_mpc.geofence.fence import Fence as Fence
    from ltv_mpc.messages import CurrentProfile as CurrentProfile
    from ltv_mpc.messages import Estimate as Estimate
    from ltv_mpc.messages import Obstacle as Obstacle
    from ltv_mpc.messages import Obstacles as Obstacles
    from ltv_mpc.messages import Plan as Plan
    from ltv_mpc.messages import PlanOrigin as PlanOrigin
    from ltv_mpc.messages import SolveStatus as SolveStatus
    from ltv_mpc.vehicle.parameters import Vehicle as Vehicle
    from services.tools.python_run import Run as Run
    from services.tools.python_run import simulate as simulate

    __version__: str

_NAMES = {
    "ltv_mpc.bathymetry": ("Bathymetry",),
    "ltv_mpc.control.config": ("ControllerConfig",),
    "ltv_mpc.control.controller": ("Controller",),
    "ltv_mpc.control.nominal_model": ("advance",),
    "ltv_mpc.control.ocp.extension": ("Limit", "Motion", "Term"),
    "ltv_mpc.control.solvers": ("solve_qp",),
    "ltv_mpc.control.solvers.sparse": ("build_qp",),
    "ltv_mpc.geofence.fence": ("Fence",),
    "ltv_mpc.messages": ("CurrentProfile", "Estimate", "Obstacle", "Obstacles", "Plan", "PlanOrigin", "SolveStatus"),
    "ltv_mpc.references": ("references",),
    "ltv_mpc.vehicle.parameters": ("Vehicle",),
    "services.tools.python_run": ("Run", "simulate"),
}
_HOME = {name: module for module, names in _NAMES.items() for name in names}

__all__ = ["__version__", *_HOME]


def __getattr__(name: str) -> object:
    """Import a public name at its first use."""
    if name == "__version__":
        return _version()
    if name not in _HOME:
        raise AttributeError(f"module 'ltv_mpc' has no attribute {name!r}")
    if name == "references":
        return import_module(_HOME[name])
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    """Return the public names, which ``ltv_mpc.<TAB>`` shows."""
    return sorted(__all__)


def _version() -> str:
    """Return the version of the installed distribution; "unknown" if there is none."""
    from importlib import metadata

    try:
        return metadata.version("auv-ltv-mpc")
    except metadata.PackageNotFoundError:
        return "unknown"
