"""Compile what tests use and a descent does not, in one process: each worker of pytest would compile it for itself.

It runs beside the linters, which leave a core idle.
"""

from __future__ import annotations

from ltv_mpc import references
from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.vehicle.parameters import Vehicle
from services.nodes import controller


def main() -> None:
    """The QP's other forms, and references that are paths."""
    vehicle, hover = Vehicle.load("paper"), references.load("hover")
    controller.rehearse(vehicle, references.load("square"), ControllerConfig())
    controller.rehearse(vehicle, hover, ControllerConfig(formulation="partial"))
    controller.rehearse(vehicle, hover, ControllerConfig(solver="daqp", formulation="condensed"))


if __name__ == "__main__":
    main()
