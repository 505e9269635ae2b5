"""A spare: a process that has done all that takes time before it is needed, without being in anyone's way.

Imports, compiled code and solvers take a second or two; the place of a dead process is to be taken within one. What is
loaded here for the shipped settings is what any settings use.
"""

from __future__ import annotations

import os
import threading

NICER = 5


def load(node: str) -> None:
    """Load what the process of ``node`` will use."""
    import services.cli.app  # noqa: F401

    match node:
        case "estimator":
            from ltv_mpc.localisation.config import EstimatorConfig
            from ltv_mpc.localisation.suite import Suite
            from services.nodes import estimator
            from services.run import water  # noqa: F401

            estimator.rehearse(Suite.load("paper"), EstimatorConfig())
        case "controller":
            from ltv_mpc import references
            from ltv_mpc.control.config import ControllerConfig
            from ltv_mpc.vehicle.parameters import Vehicle
            from services.nodes import controller

            controller.rehearse(Vehicle.load("paper"), references.load("descent"), ControllerConfig())
        case "recorder":
            from services.nodes import recorder  # noqa: F401
            from services.run.situation import resolve

            resolve("descent")
        case "router":
            from services.nodes import router  # noqa: F401


def load_gently(node: str) -> None:
    """The same while nobody else wants the processor: in a thread of low priority, for Linux's are per thread and what
    a process has lowered it may not raise again.
    """

    def gently() -> None:
        own = threading.get_native_id()
        os.setpriority(os.PRIO_PROCESS, own, os.getpriority(os.PRIO_PROCESS, own) + NICER)
        load(node)

    thread = threading.Thread(target=gently, name="load")
    thread.start()
    thread.join()
