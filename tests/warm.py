"""Compile what tests use and a descent does not, in one process: each worker of pytest would compile it for itself.

It runs beside the linters, which leave a core idle.
"""

from __future__ import annotations

from ltv_mpc import references
from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.vehicle.parameters import Vehicle
from services.processes import controller


def main() -> None:
    """Compile the cycle along references that are paths."""
    controller.warm_up(Vehicle.load("paper"), references.load("square"), ControllerConfig())


if __name__ == "__main__":
    main()
