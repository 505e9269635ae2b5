"""Process with many controllers; each vehicle has its own node, message validator and state.

    python -m benchmarks.fleet.controllers FLEET FIRST    of vehicles FIRST, FIRST + processes, ...

A cycle begins when its estimate arrives. Where the process falls behind, a vehicle's newest estimate counts, and those
that it overtook are counted.
"""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Iterable

import msgspec

from benchmarks.fleet.fleet import Fleet, namespace, now_ns, wait_for_start
from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.control.node import ControllerNode
from ltv_mpc.messages import Action, Applied, Command, Estimate, Plan
from ltv_mpc.node import ReceivedMessage
from ltv_mpc.references import Point
from ltv_mpc.vehicle.parameters import Vehicle
from services.bus.mailbox import Frame, Mailbox
from services.bus.message_validation import MessageValidator
from services.bus.options import BusOptions
from services.bus.outbox import Outbox, new_epoch
from services.bus.session import Session, open_session
from services.bus.topics import BY_TYPE
from services.bus.wire import WireError
from services.processes.controller import warm_up
from sim.evaluation.metrics import quantiles
from sim.evaluation.summary import Quantiles


class Controllers(msgspec.Struct, frozen=True, kw_only=True):
    """Measurements of a process of controllers."""

    vehicles: int
    cycles: int
    overtaken: int  # estimates that no cycle was made on
    rejected: int
    dropped: int
    cycle_ms: Quantiles  # decoding, cycle, encoding, publishing: median, p99, max
    cpu_s: float


def main(fleet: Fleet, first: int) -> Controllers:
    """Run the process: the controllers of these vehicles."""
    vehicle = Vehicle.load(fleet.vehicle).at_origin()  # of which the plants publish estimates
    config = ControllerConfig(horizon_s=fleet.horizon_s, period_s=1.0 / fleet.rate_hz)
    point = Point(north_m=0.0, east_m=0.0, depth_m=10.0)
    warm_up(vehicle, point, config)
    with open_session(BusOptions(connect=(fleet.router,)), stop=lambda: False, say=lambda _text: None) as session:
        mailbox = Mailbox()
        by_vehicle = {
            number: _VehicleController(ControllerNode(vehicle, point, config), session, mailbox, number)
            for number in range(first, fleet.vehicles, fleet.processes)
        }
        return _run(fleet, by_vehicle, mailbox, wait_for_start())


class _VehicleController:
    """Controller of one vehicle on the shared session."""

    def __init__(self, node: ControllerNode, session: Session, mailbox: Mailbox, number: int) -> None:
        self.node = node
        self.validator = MessageValidator()
        self.overtaken = 0  # estimates
        self._frames: list[Frame] = []
        self._armed = False
        under = namespace(number)
        self.out = Outbox(session, node=node.name, epoch=new_epoch(), kinds=(Plan,), key_prefix=under)
        for kind in (Applied, Estimate):
            session.subscribe(f"{under}/{BY_TYPE[kind].key}", BY_TYPE[kind], mailbox)

    def receive(self, frame: Frame) -> None:
        """Keep a frame for the next cycle, which decodes only the newest estimate."""
        self._frames.append(frame)

    def cycle(self, start_ns: int) -> None:
        """Run a cycle on the frames that have arrived."""
        frames, self._frames = self._frames, []
        newest = max((k for k, frame in enumerate(frames) if _is_estimate(frame)), default=None)
        arrivals = (
            [] if self._armed else [ReceivedMessage(Command(command_id=0, action=Action.ARM, force=True), 1, 0, 0)]
        )
        self._armed = True
        for k, frame in enumerate(frames):
            if _is_estimate(frame) and k != newest:
                self.overtaken += 1
                continue
            try:
                message, header = self.validator.validate(frame)
            except WireError:  # counted by the validator
                continue
            received_ns = frame.received_monotonic_us * 1000 - start_ns
            arrivals.append(ReceivedMessage(message, header.epoch, header.sequence, received_ns))
        (outputs,) = self.node.steps([(now_ns(start_ns), arrivals)])
        for message in outputs:
            if isinstance(message, Plan):
                self.out.publish(message)


def _is_estimate(frame: Frame) -> bool:
    return frame.topic is not None and frame.topic.message_type is Estimate


def _run(fleet: Fleet, by_vehicle: dict[int, _VehicleController], mailbox: Mailbox, start_ns: int) -> Controllers:
    begin_ns, end_ns = fleet.measured_ns
    of = {
        f"{namespace(n)}/{BY_TYPE[kind].key}": controller
        for n, controller in by_vehicle.items()
        for kind in (Applied, Estimate)
    }
    waiting: dict[_VehicleController, None] = {}  # in the order in which an estimate came for them
    busy_ms: list[float] = []
    before: tuple[float, Counter[str]] | None = None
    while (t_ns := now_ns(start_ns)) < end_ns:
        if before is None and t_ns >= begin_ns:
            before = time.process_time(), _counts(by_vehicle.values())
            busy_ms.clear()
        frame = mailbox.take(0.0 if waiting else min((end_ns - t_ns) / 1e9, 0.1))
        started_ns = time.perf_counter_ns()
        while frame is not None:
            of[frame.key].receive(frame)
            if _is_estimate(frame):
                waiting.setdefault(of[frame.key])
            frame = mailbox.take(0.0)
        if not waiting:
            continue
        controller = next(iter(waiting))
        del waiting[controller]
        controller.cycle(start_ns)
        busy_ms.append((time.perf_counter_ns() - started_ns) / 1e6)
    cpu_s, counted = before or (0.0, Counter[str]())
    since = _counts(by_vehicle.values())
    since.subtract(counted)
    return Controllers(
        vehicles=len(by_vehicle),
        cycles=len(busy_ms),
        overtaken=since["overtaken"],
        rejected=since["rejected"],
        dropped=since["dropped"],
        cycle_ms=quantiles(busy_ms),
        cpu_s=time.process_time() - cpu_s,
    )


def _counts(controllers: Iterable[_VehicleController]) -> Counter[str]:
    """Sum the counts of all vehicles; overtaken estimates are subtracted from the messages lost on the way."""
    counts: Counter[str] = Counter()
    for controller in controllers:
        overtaken = {"overtaken": controller.overtaken, "dropped": controller.validator.dropped - controller.overtaken}
        counts.update(overtaken, rejected=controller.validator.rejected)
    return counts


if __name__ == "__main__":
    done = main(msgspec.json.decode(sys.argv[1], type=Fleet), int(sys.argv[2]))
    sys.stdout.buffer.write(msgspec.json.encode(done) + b"\n")
