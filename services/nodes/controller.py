"""The controller process: plans from estimates, whoever makes them."""

from __future__ import annotations

from ltv_mpc.control.config import ControllerConfig
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
    """Have all compiled code and the solver loaded: two cycles of a controller that is thrown away."""
    node = ControllerNode(vehicle, reference, config)
    for t_ns in (0, config.period_ns):
        node.step(t_ns, [Arrival(Estimate.at_rest(depth_m=0.0), 1, 0, t_ns)])
