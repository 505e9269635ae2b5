"""Process with many controllers; each vehicle has its own node, message validator and state.

    python -m benchmarks.fleet.controllers FLEET FIRST    of vehicles FIRST, FIRST + processes, ...

A cycle begins when its estimate arrives. Where the process falls behind, a vehicle's newest estimate counts; those that
it overtook are not decoded.
"""

from __future__ import annotations

import sys
import time

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

    cycle_ms: Quantiles  # decoding, cycle, encoding, publishing: median, p99, max
    cpu_s: float
    rejected: int


def main(fleet: Fleet, first: int) -> Controllers:
    """Run the process: the controllers of these vehicles."""
    vehicle = Vehicle.load(fleet.vehicle).at_origin()  # of which the plants publish estimates
    config = ControllerConfig(horizon_s=fleet.horizon_s, period_s=1.0 / fleet.rate_hz)
    point = Point(north_m=0.0, east_m=0.0, depth_m=10.0)
    warm_up(vehicle, point, config)
    with open_session(BusOptions(connect=(fleet.router,)), stop=lambda: False, say=lambda _text: None) as session:
        mailbox, by_key = Mailbox(), dict[str, _VehicleController]()
        for number in range(first, fleet.vehicles, fleet.processes):
            controller = _VehicleController(ControllerNode(vehicle, point, config), session, number)
            for kind in (Applied, Estimate):
                key = f"{namespace(number)}/{BY_TYPE[kind].key}"
                by_key[key] = controller
                session.subscribe(key, BY_TYPE[kind], mailbox)
        return _run(fleet, by_key, mailbox, wait_for_start())


class _VehicleController:
    """Controller of one vehicle on the shared session."""

    def __init__(self, node: ControllerNode, session: Session, number: int) -> None:
        self._node = node
        self.validator = MessageValidator()
        self._frames: list[Frame] = []
        self._first: list[ReceivedMessage] = [
            ReceivedMessage(Command(command_id=0, action=Action.ARM, force=True), 1, 0, 0)
        ]
        self._out = Outbox(session, node=node.name, epoch=new_epoch(), kinds=(Plan,), key_prefix=namespace(number))

    def receive(self, frame: Frame) -> bool:
        """Keep a frame for the next cycle, of estimates the newest one. Return True if it is an estimate."""
        is_estimate = frame.topic is BY_TYPE[Estimate]
        if is_estimate:
            self._frames = [other for other in self._frames if other.topic is not frame.topic]
        self._frames.append(frame)
        return is_estimate

    def cycle(self, start_ns: int) -> None:
        """Run a cycle on the frames that have arrived."""
        frames, self._frames = self._frames, []
        arrivals, self._first = self._first, []
        for frame in frames:
            try:
                message, header = self.validator.validate(frame)
            except WireError:  # counted by the validator
                continue
            received_ns = frame.received_monotonic_us * 1000 - start_ns
            arrivals.append(ReceivedMessage(message, header.epoch, header.sequence, received_ns))
        outputs = self._node.step(now_ns(start_ns), arrivals)
        for message in outputs:
            if isinstance(message, Plan):
                self._out.publish(message)


def _run(fleet: Fleet, by_key: dict[str, _VehicleController], mailbox: Mailbox, start_ns: int) -> Controllers:
    begin_ns, end_ns = fleet.measured_ns
    waiting: dict[_VehicleController, None] = {}  # in the order in which an estimate came for them
    busy_ms: list[float] = []
    cpu_s: float | None = None
    while (t_ns := now_ns(start_ns)) < end_ns:
        if cpu_s is None and t_ns >= begin_ns:
            cpu_s = time.process_time()
            busy_ms.clear()
        frame = mailbox.take(0.0 if waiting else min((end_ns - t_ns) / 1e9, 0.1))
        started_ns = time.perf_counter_ns()
        while frame is not None:
            if by_key[frame.key].receive(frame):
                waiting.setdefault(by_key[frame.key])
            frame = mailbox.take(0.0)
        if waiting:
            controller = next(iter(waiting))
            del waiting[controller]
            controller.cycle(start_ns)
            busy_ms.append((time.perf_counter_ns() - started_ns) / 1e6)
    return Controllers(
        cycle_ms=quantiles(busy_ms),
        cpu_s=time.process_time() - (cpu_s or 0.0),
        rejected=sum(controller.validator.rejected for controller in dict.fromkeys(by_key.values())),
    )


if __name__ == "__main__":
    done = main(msgspec.json.decode(sys.argv[1], type=Fleet), int(sys.argv[2]))
    sys.stdout.buffer.write(msgspec.json.encode(done) + b"\n")
