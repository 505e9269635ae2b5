"""Plant process of a fleet: motion, actuator gates and estimates of all vehicles.

There are no estimators: an estimate is the true state, with a current profile as long as a localisation filter's. Each
vehicle hovers in its own current, which its estimates contain.
"""

from __future__ import annotations

import math
import time

import msgspec
import numpy as np

from ltv_mpc import frames
from ltv_mpc.messages import Applied, CurrentProfile, Estimate, Plan
from ltv_mpc.safety.plan_gate import PlanGate, PlanVerdict
from ltv_mpc.vehicle.parameters import Vehicle
from services.bus.mailbox import Frame, Mailbox
from services.bus.message_validation import MessageValidator
from services.bus.options import BusOptions
from services.bus.outbox import Outbox, new_epoch
from services.bus.session import Session, open_session
from services.bus.topics import BY_TYPE
from services.bus.wire import WireError
from services.supervisor.parent_death import die_with_parent
from services.tools.fleet.fleet import Fleet, Wire, namespace, now_ns, wait_for_start
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
    dropped: int  # plans that never came, by their numbers
    latency_ms: Quantiles  # from an estimate's validity to its plan's arrival: median, p99, max
    mean_error_m: float  # distance from the points, over the last half
    cpu_s: float


def main(fleet: Fleet, wire: Wire, parent: int) -> None:
    """Run the plant process."""
    die_with_parent(parent)
    vehicle = Vehicle.load(fleet.vehicle)
    plants = [_Plant(vehicle, number) for number in range(fleet.vehicles)]
    plants[0].copy().go(0, 2 * STEP_NS)  # have the kernel compiled
    with open_session(BusOptions(connect=(fleet.router,)), stop=lambda: False, say=lambda _text: None) as session:
        mailbox = Mailbox()
        made = _World(fleet, plants, session, mailbox)
        wire.send(made.run(wait_for_start(wire), mailbox))


class _World:
    def __init__(self, fleet: Fleet, plants: list[_Plant], session: Session, mailbox: Mailbox) -> None:
        self._fleet, self._plants = fleet, plants
        epoch, topic = new_epoch(), BY_TYPE[Plan]
        self._out = [
            Outbox(session, node="plant", epoch=epoch, kinds=(Estimate, Applied), key_prefix=namespace(i))
            for i in range(len(plants))
        ]
        self._of = {f"{namespace(i)}/{topic.key}": i for i in range(len(plants))}
        for key in self._of:
            session.subscribe(key, topic, mailbox)
        self._validator = MessageValidator()
        self._latencies_ns: list[int] = []
        self._errors_m: list[float] = []
        self._plans = self._estimates = self._late = self._refused = 0

    def run(self, start_ns: int, mailbox: Mailbox) -> Plants:
        fleet, count = self._fleet, len(self._plants)
        begin_ns, end_ns = round(fleet.warm_up_s * 1e9), round((fleet.warm_up_s + fleet.seconds) * 1e9)
        cpu_s: float | None = None
        turn, k = 0, 0
        while (due_ns := fleet.due_ns(turn, k)) < end_ns:
            while (left_ns := due_ns - now_ns(start_ns)) > 0:
                frame = mailbox.take(left_ns / 1e9)
                if frame is not None:
                    self._take(frame, frame.received_monotonic_us * 1000 - start_ns, counts=due_ns >= begin_ns)
            if cpu_s is None and due_ns >= begin_ns:
                cpu_s = time.process_time()
            self._tick(turn, due_ns, counts=due_ns >= begin_ns, settled=due_ns >= (begin_ns + end_ns) // 2)
            turn = (turn + 1) % count
            k += turn == 0
        return Plants(
            estimates=self._estimates,
            plans=self._plans,
            late=self._late,
            refused=self._refused,
            dropped=self._validator.dropped,
            latency_ms=quantiles([x / 1e6 for x in self._latencies_ns]),
            mean_error_m=float(np.mean(self._errors_m)) if self._errors_m else math.nan,
            cpu_s=time.process_time() - (cpu_s or 0.0),
        )

    def _tick(self, number: int, t_ns: int, *, counts: bool, settled: bool) -> None:
        plant, out = self._plants[number], self._out[number]
        plant.go(plant.t_ns, t_ns)
        out.publish(plant.report(t_ns))
        out.publish(plant.estimate(t_ns))
        self._estimates += counts
        if settled:
            self._errors_m.append(plant.off_m)

    def _take(self, frame: Frame, t_ns: int, *, counts: bool) -> None:
        try:
            plan, header = self._validator.validate(frame)
        except WireError:
            self._refused += 1
            return
        assert isinstance(plan, Plan)
        verdict = self._plants[self._of[frame.key]].offer(plan, header.epoch, header.sequence, t_ns)
        if counts:
            self._plans += 1
            self._late += verdict is PlanVerdict.LATE
            self._refused += verdict not in (PlanVerdict.ACCEPTED, PlanVerdict.LATE)
            self._latencies_ns.append(t_ns - plan.estimate_t_ns)


class _Plant:
    """Plant of one vehicle."""

    def __init__(self, vehicle: Vehicle, number: int) -> None:
        draw = np.random.default_rng(number)
        self._vehicle, self._number = vehicle, number
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
        self.t_ns = 0
        self._command = (0.0, 0.0, 0.0)
        self._accepted: tuple[Plan, int, int, int] | None = None

    def copy(self) -> _Plant:
        """Return a new plant with the same initial state."""
        return _Plant(self._vehicle, self._number)

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

    def go(self, from_ns: int, until_ns: int) -> None:
        """Integrate the motion in steps of 10 ms, under the commands of the gate."""
        times = [*range(from_ns, until_ns, STEP_NS), until_ns] if until_ns > from_ns else [from_ns]
        commands = np.empty((len(times), 3))
        commands[0] = self._command
        if len(times) > 1:
            commands[1:] = self._gate.commands_at(times[1:])
        self._command = tuple(commands[-1].tolist())
        profile = np.array([self._current, self._current])
        vehicle = motion.MotionState(self._state, self._revolutions, self._thrust)
        water = WaterSample(DEPTHS, profile, profile, 0.0)
        motion.simulate(self._body, vehicle, np.array(times) * 1e-9, commands, water)
        self.t_ns = until_ns

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
