"""The controller process: plans from estimates, whoever makes them."""

from __future__ import annotations

import math

import msgspec

from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.control.controller import OLDEST_ESTIMATE_NS
from ltv_mpc.control.node import ControllerNode
from ltv_mpc.node import Arrival
from ltv_mpc.references import Reference
from ltv_mpc.signals import Estimate
from ltv_mpc.vehicle.parameters import Vehicle
from services.bus.session import BusOptions
from services.process.runner import Runner
from services.process.serve import serve
from services.process.stopwatch import StageTimer


def main(
    vehicle: Vehicle,
    reference: Reference,
    config: ControllerConfig,
    bus: BusOptions,
    *,
    compute_delay_s: float = 0.0,
    own_clock: bool = False,
) -> int:
    """A plan each cycle. ``own_clock``: nobody keeps the time; it counts seconds from its own start."""
    rehearse(vehicle, reference, config)
    stages = StageTimer()
    return serve(
        ControllerNode.name,
        bus,
        lambda request, say: Runner(
            ControllerNode(vehicle, reference, config, stopwatch=stages),
            stop=request,
            say=say,
            own_clock=own_clock,
            compute_delay_ns=round(compute_delay_s * 1e9),
            stages=stages,
        ),
    )


def rehearse(vehicle: Vehicle, reference: Reference, config: ControllerConfig) -> None:
    """Have all compiled code and the solver loaded: some cycles of a controller that is thrown away.

    At the line; far off it, where the solver takes more than one turn and the step more than one try; with an estimate
    that is no number, and with one that is too old, where the thrusters are let go.
    """
    node = ControllerNode(vehicle, reference, config)
    begun = 0 if reference.start_s is None else max(0, round(reference.start_s * 1e9))
    here = Estimate.at_rest(depth_m=0.0, heading_rad=1.0)
    off = Estimate.at_rest(depth_m=0.0, heading_rad=3.0, north_m=3.0, east_m=1.0)
    broken = Estimate.at_rest(depth_m=0.0, heading_rad=math.nan)
    for k, estimate in enumerate((here, here, off, off, broken)):
        t_ns = begun + k * config.period_ns
        node.step(t_ns, [Arrival(msgspec.structs.replace(estimate, t_ns=t_ns), 1, k, t_ns)])
    node.step(t_ns + 2 * OLDEST_ESTIMATE_NS, [])
