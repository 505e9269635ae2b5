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
from ltv_mpc import frames
from ltv_mpc.messages import Applied, CurrentProfile, Estimate, Plan
from ltv_mpc.safety.plan_gate import PlanGate, PlanVerdict
from ltv_mpc.vehicle.parameters import Vehicle
from services.bus.mailbox import Mailbox
from services.bus.message_validation import MessageValidator
from services.bus.options import BusOptions
from services.bus.outbox import Outbox, new_epoch
from services.bus.session import open_session
from services.bus.topics import BY_TYPE
from services.bus.wire import WireError
from sim import motion
from sim.evaluation.metrics import quantiles
from sim.evaluation.summary import Quantiles
from sim.plant import level_to_ned
from sim.water.column import WaterSample

STEP_NS = 10_000_000
CELLS = 71
"""Number of depths of a profile, as in the filter's of 70 m."""
DEPTHS = np.array([0.0, 100.0])
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
    _Plant(vehicle, 0).go(2 * STEP_NS)  # have the kernel compiled
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
    validator, refused, late, cpu_s = MessageValidator(), 0, 0, 0.0
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
            verdict = by_key[frame.key].offer(plan, header.epoch, header.sequence, t_ns)
            if due_ns >= begin_ns:
                latency_ms.append((t_ns - plan.estimate_t_ns) / 1e6)
                late += verdict is PlanVerdict.LATE
                refused += verdict not in (PlanVerdict.ACCEPTED, PlanVerdict.LATE)
        if due_ns < begin_ns or not cpu_s:
            cpu_s = time.process_time()
        plant, out = plants[i]
        plant.go(due_ns)
        out.publish(plant.report(due_ns))
        out.publish(plant.estimate(due_ns))
        if due_ns >= (begin_ns + end_ns) // 2:
            errors_m.append(plant.off_m)
    return Plants(
        estimates=estimates,
        plans=len(latency_ms),
        late=late,
        refused=refused,
        latency_ms=quantiles(latency_ms),
        mean_error_m=float(np.mean(errors_m)) if errors_m else math.nan,
        cpu_s=time.process_time() - cpu_s,
    )


class _Plant:
    """Plant of one vehicle."""

    def __init__(self, vehicle: Vehicle, number: int) -> None:
        draw = np.random.default_rng(number)
        self._body = motion.pack(vehicle)
        self._gate = PlanGate(vehicle)
        north, east, heading = draw.uniform(-OFF_M, OFF_M), draw.uniform(-OFF_M, OFF_M), draw.uniform(-3.0, 3.0)
        self._state = np.array([north, east, 0.0, 0.0, heading, 0.0, 10.0, 0.0])
        self._revolutions, self._thrust = np.zeros(3), np.zeros(3)
        way = draw.uniform(-math.pi, math.pi)
        self._current = SPEED_MPS * math.cos(way), SPEED_MPS * math.sin(way)
        depth = np.arange(float(CELLS))
        self._profile = CurrentProfile(
            depth_m=depth,
            north_mps=np.full(CELLS, self._current[0]),
            east_mps=np.full(CELLS, self._current[1]),
            sd_mps=np.full(CELLS, 0.01),
        )
        self._t_ns = 0
        self._command = (0.0, 0.0, 0.0)
        self._accepted: tuple[Plan, int, int, int] | None = None

    @property
    def off_m(self) -> float:
        """Return the distance from the vehicle's target, the origin (m)."""
        return math.hypot(self._state[0], self._state[1])

    def offer(self, plan: Plan, epoch: int, sequence: int, t_ns: int) -> PlanVerdict:
        """Offer a received plan to the actuators' gate."""
        verdict = self._gate.offer(plan, epoch, sequence, t_ns)
        if verdict in (PlanVerdict.ACCEPTED, PlanVerdict.LATE):
            self._accepted = plan, epoch, sequence, t_ns
        return verdict

    def go(self, until_ns: int) -> None:
        """Integrate the motion in steps of 10 ms, under the commands of the gate."""
        if until_ns <= self._t_ns:
            return
        times = [*range(self._t_ns, until_ns, STEP_NS), until_ns]
        commands = np.empty((len(times), 3))
        commands[0] = self._command
        commands[1:] = self._gate.commands_at(times[1:])
        self._command = tuple(commands[-1].tolist())
        profile = np.array([self._current, self._current])
        vehicle = motion.MotionState(self._state, self._revolutions, self._thrust)
        water = WaterSample(DEPTHS, profile, profile, 0.0)
        motion.simulate(self._body, vehicle, np.array(times) * 1e-9, commands, water)
        self._t_ns = until_ns

    def estimate(self, t_ns: int) -> Estimate:
        """Return the true state as an estimate."""
        n, e, u, v, psi, r, z, w = self._state.tolist()
        north, east = level_to_ned(u, v, psi)
        return Estimate(
            t_ns=t_ns,
            north_m=n,
            east_m=e,
            heading_rad=frames.wrap_angle(psi),
            yaw_rate_radps=r,
            velocity_north_mps=north + self._current[0],
            velocity_east_mps=east + self._current[1],
            depth_m=z,
            velocity_down_mps=w,
            current=self._profile,
        )

    def report(self, t_ns: int) -> Applied:
        """Return the actuators' report."""
        plan, epoch, sequence, received_ns = self._accepted or (None, 0, -1, 0)
        x, y, z = self._thrust.tolist()
        return Applied(
            t_ns=t_ns,
            thrust_N=(x, y, z),
            command_N=self._command,
            command_slew_N_per_s=(0.0, 0.0, 0.0),
            plan_epoch=epoch,
            plan_sequence=sequence,
            plan_cycle_t_ns=0 if plan is None else plan.cycle_t_ns,
            plan_received_t_ns=received_ns,
            plan_late=False,
            plans_late=self._gate.plans_late,
            plans_rejected=self._gate.plans_rejected,
        )


if __name__ == "__main__":
    done = main(msgspec.json.decode(sys.argv[1], type=Fleet))
    sys.stdout.buffer.write(msgspec.json.encode(done) + b"\n")
