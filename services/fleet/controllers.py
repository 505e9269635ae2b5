"""Many controllers in one process: each vehicle has its node, its door and its memory, and shares nothing with others.

A cycle begins when its estimate arrives. Where the process falls behind, a vehicle's newest estimate counts, and those
that it overtook are counted.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

import msgspec

from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.control.node import ControllerNode
from ltv_mpc.node import Arrival
from ltv_mpc.references import Point
from ltv_mpc.signals import Action, Applied, Command, Estimate, Plan
from ltv_mpc.vehicle.parameters import Vehicle
from services.bus.door import Door
from services.bus.mailbox import Frame, Mailbox
from services.bus.outbox import Outbox, new_epoch
from services.bus.session import BusOptions, Session, open_session
from services.bus.topics import BY_SIGNAL
from services.bus.wire import WireError
from services.fleet.place import Fleet, Wire, begin, namespace, now_ns
from services.launch.orphans import die_with_parent
from services.nodes.controller import rehearse
from sim.grading.metrics import quantiles
from sim.grading.summary import Quantiles


class Controllers(msgspec.Struct, frozen=True, kw_only=True):
    """What a controllers' process has measured."""

    vehicles: int
    cycles: int
    overtaken: int  # estimates that no cycle was made on
    rejected: int
    dropped: int
    cycle_ms: Quantiles  # decoding, cycle, encoding, publishing: median, p99, max
    cpu_s: float


def main(fleet: Fleet, numbers: Sequence[int], wire: Wire, parent: int) -> None:
    """The process: the controllers of these vehicles."""
    die_with_parent(parent)
    vehicle = Vehicle.load(fleet.vehicle)
    config = ControllerConfig(horizon_s=fleet.horizon_s, period_s=1.0 / fleet.rate_hz)
    point = Point(north_m=0.0, east_m=0.0, depth_m=10.0)
    rehearse(vehicle, point, config)
    with open_session(BusOptions(connect=(fleet.router,)), stop=lambda: False, say=lambda _text: None) as session:
        mailbox = Mailbox()
        helms = {number: _Helm(ControllerNode(vehicle, point, config), session, mailbox, number) for number in numbers}
        wire.send(_run(fleet, helms, mailbox, begin(wire)))


class _Helm:
    """One vehicle's controller on the shared session."""

    def __init__(self, node: ControllerNode, session: Session, mailbox: Mailbox, number: int) -> None:
        self.node = node
        self.door = Door()
        self.pending: list[Arrival] = [Arrival(Command(command_id=0, action=Action.ARM), 1, 0, 0)]
        self.waits = False
        under = namespace(number)
        self.out = Outbox(session, node=node.name, epoch=new_epoch(), kinds=(Plan,), under=under)
        for kind in (Applied, Estimate):
            session.subscribe(f"{under}/{BY_SIGNAL[kind].key}", BY_SIGNAL[kind], mailbox)

    def cycle(self, t_ns: int) -> None:
        """On what has arrived."""
        arrivals, self.pending, self.waits = self.pending, [], False
        for signal in self.node.step(t_ns, arrivals):
            if isinstance(signal, Plan):
                self.out.publish(signal)


def _run(fleet: Fleet, helms: dict[int, _Helm], mailbox: Mailbox, start_ns: int) -> Controllers:
    begin_ns, end_ns = round(fleet.warm_up_s * 1e9), round((fleet.warm_up_s + fleet.seconds) * 1e9)
    of = {f"{namespace(n)}/{BY_SIGNAL[kind].key}": helm for n, helm in helms.items() for kind in (Applied, Estimate)}
    waiting: dict[int, _Helm] = {}  # by the place of its namespace, in the order of arrival
    cycles = overtaken = rejected = 0
    busy_ms: list[float] = []
    cpu_s: float | None = None

    def take(frame: Frame) -> None:
        nonlocal overtaken, rejected
        helm = of[frame.key]
        try:
            signal, header = helm.door.admit(frame)
        except WireError:
            rejected += 1
            return
        received_ns = frame.received_monotonic_us * 1000 - start_ns
        helm.pending.append(Arrival(signal, header.epoch, header.sequence, received_ns))
        if isinstance(signal, Estimate):
            overtaken += helm.waits
            helm.waits = True
            waiting.setdefault(id(helm), helm)

    while (t_ns := now_ns(start_ns)) < end_ns:
        if cpu_s is None and t_ns >= begin_ns:
            cpu_s, cycles, overtaken, rejected = time.process_time(), 0, 0, 0
            busy_ms.clear()
        frame = mailbox.take(0.0 if waiting else min((end_ns - t_ns) / 1e9, 0.1))
        started_ns = time.perf_counter_ns()
        while frame is not None:
            take(frame)
            frame = mailbox.take(0.0)
        if not waiting:
            continue
        helm = waiting.pop(next(iter(waiting)))
        helm.cycle(now_ns(start_ns))
        cycles += 1
        busy_ms.append((time.perf_counter_ns() - started_ns) / 1e6)
    return Controllers(
        vehicles=len(helms),
        cycles=cycles,
        overtaken=overtaken,
        rejected=rejected,
        dropped=sum(helm.door.dropped for helm in helms.values()),
        cycle_ms=quantiles(busy_ms),
        cpu_s=time.process_time() - (cpu_s or 0.0),
    )
