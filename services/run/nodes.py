"""Nodes of a simulated run, built from its configuration in the same way for lock step and replay."""

from __future__ import annotations

from collections.abc import Sequence

from ltv_mpc.control.node import ControllerNode
from ltv_mpc.control.ocp.extension import Limit, Term
from ltv_mpc.control.solvers import SolverFactory, make
from ltv_mpc.localisation.estimator import Estimator
from ltv_mpc.node import Node
from services.run.run_config import RunConfig
from sim.plant import Plant
from sim.sensors.node import Sensors


def make_nodes(
    run_config: RunConfig,
    *,
    publish_unread_topics: bool = True,
    terms: Sequence[Term | Limit] = (),
    make_solver: SolverFactory = make,
) -> list[Node]:
    """Build every node of a run, in the order of the process table.

    With ``publish_unread_topics`` the sensors also publish messages that no other node reads, for a recording.
    The controller takes ``terms`` and ``make_solver``.
    """
    scenario = run_config.scenario
    plant = Plant(scenario, run_config.vehicle, run_config.water)
    controller = ControllerNode(
        run_config.vehicle,
        run_config.reference,
        run_config.controller,
        fence=run_config.fence,
        terms=terms,
        make_solver=make_solver,
    )
    if run_config.bathymetry is not None:
        controller.controller.set_bathymetry(run_config.bathymetry)
    aboard: list[Node] = [controller]
    if not scenario.run.perfect_state:  # else the sensors themselves write the estimate
        aboard.insert(0, Estimator(run_config.sensor_config, scenario.estimator, run_config.prior))
    needed_types = None if publish_unread_topics else frozenset(kind for node in aboard for kind in node.reads)
    return [plant, Sensors(scenario, run_config.sensor_config, run_config.water, needed=needed_types), *aboard]
