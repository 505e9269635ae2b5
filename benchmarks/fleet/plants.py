"""Plant process of a fleet: motion, actuator gates and estimates of all vehicles.

    python -m benchmarks.fleet.plants FLEET

There are no estimators: an estimate is the true state, with a current profile as long as a localisation filter's. Each
vehicle hovers in its own current, which its estimates contain.
"""

from __future__ import annotations

import math
import sys
import time

import msgspec
import numpy as np

from benchmarks.fleet.fleet import Fleet, namespace, now_ns, wait_for_start
from ltv_mpc.messages import Applied, CurrentProfile, Estimate, Plan, Truth
from ltv_mpc.node import ReceivedMessage
from ltv_mpc.vehicle.parameters import Vehicle
from services.bus.mailbox import Mailbox
from services.bus.message_validation import MessageValidator
from services.bus.options import BusOptions
from services.bus.outbox import Outbox, new_epoch
from services.bus.session import open_session
from services.bus.topics import BY_TYPE
from services.bus.wire import WireError
from sim import plant
from sim.evaluation.metrics import quantiles
from sim.evaluation.summary import Quantiles
from sim.scenario import Plant, Run, Scenario
from sim.water import WaterColumn

STEP_NS = 10_000_000
CELLS = 71
"""Number of depths of a profile, as in the filter's of 70 m."""
SPEED_MPS = 0.1
"""Speed of the currents."""
OFF_M = 0.3
"""Largest initial distance of a vehicle from its point, in each direction."""


class Plants(msgspec.Struct, frozen=True, kw_only=True):
    """Measurements of the plant process."""

    estimates: int
    plans: int
    late: int  # plans that came after their start
    refused: int
    latency_ms: Quantiles  # from an estimate's validity to its plan's arrival: median, p99, max
    mean_error_m: float  # distance from the points, over the last half
    cpu_s: float


def main(fleet: Fleet) -> Plants:
    """Run the plant process."""
    vehicle = Vehicle.load(fleet.vehicle)
    first = _Plant(vehicle, 0)
    for t_ns in (0, 2 * STEP_NS):  # have the kernel compiled
        first.step(t_ns)
    with open_session(BusOptions(connect=(fleet.router,)), stop=lambda: False, say=lambda _text: None) as session:
        mailbox, epoch, topic = Mailbox(), new_epoch(), BY_TYPE[Plan]
        plants, outs, by_key = [], [], {}
        for number in range(fleet.vehicles):
            prefix = namespace(number)
            plants.append(_Plant(vehicle, number))
            outs.append(Outbox(session, node="plant", epoch=epoch, kinds=(Estimate, Applied), key_prefix=prefix))
            by_key[f"{prefix}/{topic.key}"] = plants[-1]
            session.subscribe(f"{prefix}/{topic.key}", topic, mailbox)
        return _run(fleet, list(zip(plants, outs, strict=True)), by_key, mailbox, wait_for_start())


def _run(
    fleet: Fleet, plants: list[tuple[_Plant, Outbox]], by_key: dict[str, _Plant], mailbox: Mailbox, start_ns: int
) -> Plants:
    begin_ns, end_ns = fleet.measured_ns
    validator, refused, cpu_s, before = MessageValidator(), 0, 0.0, [(0, 0)] * len(plants)
    latency_ms: list[float] = []
    errors_m: list[float] = []
    due = sorted((fleet.due_ns(i, k), i) for i in range(fleet.vehicles) for k in range(end_ns // fleet.period_ns + 1))
    due = [(due_ns, i) for due_ns, i in due if due_ns < end_ns]
    estimates = sum(due_ns >= begin_ns for due_ns, _ in due)
    for due_ns, i in due:
        while (left_ns := due_ns - now_ns(start_ns)) > 0:
            frame = mailbox.take(left_ns / 1e9)
            if frame is None:
                continue
            t_ns = frame.received_monotonic_us * 1000 - start_ns
            try:
                plan, header = validator.validate(frame)
            except WireError:
                refused += 1
                continue
            assert isinstance(plan, Plan)
            by_key[frame.key].inbox.append(ReceivedMessage(plan, header.epoch, header.sequence, t_ns))
            if due_ns >= begin_ns:
                latency_ms.append((t_ns - plan.estimate_t_ns) / 1e6)
        craft, out = plants[i]
        if due_ns < begin_ns or not cpu_s:
            cpu_s = time.process_time()
            before[i] = craft.counts
        for message in craft.step(due_ns):
            out.publish(message)
        if due_ns >= (begin_ns + end_ns) // 2:
            errors_m.append(craft.off_m)
    late, rejected = np.subtract([craft.counts for craft, _ in plants], before).sum(axis=0).tolist()
    return Plants(
        estimates=estimates,
        plans=len(latency_ms),
        late=late,
        refused=refused + rejected,
        latency_ms=quantiles(latency_ms),
        mean_error_m=float(np.mean(errors_m)) if errors_m else math.nan,
        cpu_s=time.process_time() - cpu_s,
    )


class _Plant:
    """Plant of one vehicle, with an estimate of its true state."""

    def __init__(self, vehicle: Vehicle, number: int) -> None:
        draw = np.random.default_rng(number)
        north, east, heading = draw.uniform(-OFF_M, OFF_M), draw.uniform(-OFF_M, OFF_M), draw.uniform(-3.0, 3.0)
        way = draw.uniform(-math.pi, math.pi)
        current = np.tile([SPEED_MPS * math.cos(way), SPEED_MPS * math.sin(way)], (CELLS, 1))
        depth_m, sd_mps = np.arange(float(CELLS)), np.full(CELLS, 0.01)
        self._profile = CurrentProfile(depth_m=depth_m, north_mps=current[:, 0], east_mps=current[:, 1], sd_mps=sd_mps)
        start = Plant(north_m=north, east_m=east, heading_rad=heading, depth_m=10.0, tilt_rms_rad=0.0)
        scenario = Scenario(title="fleet", run=Run(arm=False), plant=start)
        self._node = plant.Plant(scenario, vehicle, WaterColumn(depth_m, current))
        self.inbox: list[ReceivedMessage] = []
        """Plans since the last step."""
        self.off_m = 0.0
        """Distance from the vehicle's target, the origin."""
        self.counts = 0, 0
        """Plans that came late, and plans that were rejected."""

    def step(self, t_ns: int) -> list[Applied | Estimate]:
        """Simulate to a time; return the actuators' newest report, if plans have come, and the true state."""
        inbox, self.inbox = self.inbox, []
        outputs = self._node.step(t_ns, inbox)
        reports = [message for message in outputs if isinstance(message, Applied)][-1:]
        for report in reports:
            self.counts = report.plans_late, report.plans_rejected
        truth = [message for message in outputs if isinstance(message, Truth)][-1]
        (north, east, depth), velocity = truth.position_m, truth.velocity_mps
        self.off_m = math.hypot(north, east)
        estimate = Estimate(
            t_ns=t_ns,
            north_m=north,
            east_m=east,
            heading_rad=truth.attitude_rad[2],
            yaw_rate_radps=truth.yaw_rate_radps,
            velocity_north_mps=velocity[0],
            velocity_east_mps=velocity[1],
            depth_m=depth,
            velocity_down_mps=velocity[2],
            current=self._profile,
        )
        return [*reports, estimate]


if __name__ == "__main__":
    done = main(msgspec.json.decode(sys.argv[1], type=Fleet))
    sys.stdout.buffer.write(msgspec.json.encode(done) + b"\n")
