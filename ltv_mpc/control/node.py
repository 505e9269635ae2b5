"""The controller as a node: a cycle every 0.3 s on the newest estimate."""

from __future__ import annotations

from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.control.controller import Controller
from ltv_mpc.node import Cycle, Inbox, Stopwatch, no_stopwatch
from ltv_mpc.references import Reference
from ltv_mpc.signals import Applied, CycleTiming, Estimate, Plan, Signal
from ltv_mpc.vehicle.parameters import Vehicle


class ControllerNode:
    """Reads the newest ``Estimate``, each ``Applied`` and ``CycleTiming``; writes one ``Plan`` a cycle."""

    name = "controller"
    reads: tuple[type[Signal], ...] = (Estimate, Applied, CycleTiming)
    writes: tuple[type[Signal], ...] = (Plan,)

    def __init__(
        self,
        vehicle: Vehicle,
        reference: Reference,
        config: ControllerConfig,
        *,
        stopwatch: Stopwatch = no_stopwatch,
    ) -> None:
        self.schedule = Cycle(config.period_ns)
        self.controller = Controller(vehicle, reference, config, stopwatch=stopwatch)
        self._estimate: Estimate | None = None

    def step(self, t_ns: int, inbox: Inbox) -> list[Signal]:
        """One cycle at ``t_ns``; silent until the first estimate."""
        for arrival in inbox:
            self.hear(arrival.signal)
        return [] if self._estimate is None else [self.cycle(self._estimate, t_ns)]

    def hear(self, signal: Signal) -> None:
        """One message."""
        match signal:
            case Estimate() as estimate if self._estimate is None or estimate.t_ns > self._estimate.t_ns:
                self._estimate = estimate
            case Applied() as applied:
                self.controller.report(applied)
            case CycleTiming() as timing:
                self.controller.timing(timing)
            case _:
                pass

    def cycle(self, estimate: Estimate, t_ns: int) -> Plan:
        """What a cycle does with the newest estimate."""
        return self.controller.plan(estimate, t_ns=t_ns)
