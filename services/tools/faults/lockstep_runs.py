"""Fault injection in lock step: one run with its faults, and the observations from its messages."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import msgspec
import numpy as np

from ltv_mpc.messages import (
    Applied,
    ClockStep,
    Disturbance,
    Estimate,
    FilterStatus,
    Health,
    LocalisationReport,
    Message,
    MessageFault,
    ModelCheck,
    Pair,
    Plan,
    PlanOrigin,
    RejectedFrame,
    SensorStatus,
    Truth,
)
from ltv_mpc.node import Node, ReceivedMessage
from ltv_mpc.validation import rejection_reason
from ltv_mpc.vehicle.parameters import Vehicle
from ltv_mpc.vehicle.reference_point import ReferencePoint
from services.bus import topics, wire
from services.bus.mailbox import Frame
from services.bus.message_validation import MessageValidator
from services.run.nodes import make_nodes
from services.run.run_config import Override, RunConfig, resolve
from services.tools import lockstep_run
from services.tools.faults.draw import Run
from services.tools.faults.fault import Fault
from services.tools.faults.kinds import INSTRUMENTS, MESSAGES
from services.tools.faults.own_clock import ClockStepFault, OwnClock
from sim.faults import second_source, world
from sim.faults.antenna import Antenna
from sim.faults.interval import Interval
from sim.faults.message_faults import MessageFaultInterval, MessageFaults
from sim.faults.restarted_node import RestartedNode
from sim.faults.second_source import SecondSource
from sim.faults.sensor_faults import Failure, FaultySensors, SensorFault
from sim.faults.solver_faults import SolverClock, SolverFault, SolverFaultInterval, TimedNode, faulty_solvers
from sim.scheduler import EPOCH, Delivery, LockStep, Observation, Step

SCENARIO = "hover"

INTRUDERS_EPOCH = 7
"""Epoch of the second commander's messages, which is another process than the controller."""

RESTARTED_EPOCH = 100
"""Difference between the epochs of a controller and of the one that replaces it."""

POLL_NS = 500_000_000
"""Time between two readings of the validators' counts."""

SLEW_ROUNDING = 1e-6
"""Tolerance (N/s) of the largest slew between two reports, a difference of commands over 10 ms."""


class PlanSeen(NamedTuple):
    """Published plan."""

    published_ns: int
    cycle_ns: int
    origin: PlanOrigin
    health: Health
    health_why: str
    finite: bool


class GateSeen(NamedTuple):
    """Last accepted plan and health, as the actuators report them."""

    t_ns: int
    received_ns: int
    cycle_ns: int
    health: Health


class ReportSeen(NamedTuple):
    """Localisation report; ``wrong``: the status of each sensor that is not OK."""

    t_ns: int
    nominal: bool
    wrong: Mapping[str, SensorStatus]


@dataclass
class Log:
    """Time-ordered observations of a run's steps and messages; an observer of the lock step."""

    vehicle: Vehicle
    tap: Callable[[Message], None] = lambda _: None
    truth: list[tuple[int, float, float, float, float]] = field(default_factory=list)  # t, n, e, v_n, v_e
    estimate: list[tuple[int, float, float, float, float]] = field(default_factory=list)
    squares: list[tuple[float, ...]] = field(default_factory=list)  # covariances (2, 2) of position, of velocity
    target: list[tuple[int, Pair]] = field(default_factory=list)
    plans: list[PlanSeen] = field(default_factory=list)
    cycles: list[int] = field(default_factory=list)  # starts
    applied: list[tuple[int, bool, int, int, int]] = field(default_factory=list)  # t, bad, epoch, refused, late
    gate: list[GateSeen] = field(default_factory=list)
    rejected: list[tuple[int, str, str]] = field(default_factory=list)  # t, reader, key
    reports: list[ReportSeen] = field(default_factory=list)
    alarms: list[tuple[int, bool]] = field(
        default_factory=list
    )  # of the model check: time of publication, and whether it is an alarm
    propeller_thrust: list[tuple[int, float, float]] = field(default_factory=list)  # t, port and starboard (N)
    received_estimates: list[tuple[int, int]] = field(
        default_factory=list
    )  # estimates that the controller accepted: t received, t valid
    named_points: list[int] = field(default_factory=list)  # alarms of the model check that name the reference point
    clock_steps: list[int] = field(default_factory=list)  # times at which a clock step was reported to the controller

    def __post_init__(self) -> None:
        self._box = np.array([[t.min_N, t.max_N] for t in self.vehicle.thrusters])
        self._slew = np.array([t.slew_N_per_s for t in self.vehicle.thrusters])

    def stepped(self, step: Step) -> None:
        """Record cycles of the controller and the estimates in their inbox."""
        if step.node != "controller":
            return
        self.cycles.append(step.at_ns)
        self.received_estimates += [
            (a.received_t_ns, a.message.t_ns)
            for a in step.inbox
            if isinstance(a.message, Estimate) and a.epoch != second_source.EPOCH
        ]
        self.clock_steps += [a.received_t_ns for a in step.inbox if isinstance(a.message, ClockStep)]

    def published(self, node: str, message: ReceivedMessage) -> None:
        """Record a message as its writer published it."""
        self.tap(message.message)
        match message.message:
            case Truth() as s:
                self.truth.append((s.t_ns, *s.position_m[:2], *s.velocity_mps[:2]))
            case Estimate() as s:
                self.estimate.append((s.t_ns, s.north_m, s.east_m, s.velocity_north_mps, s.velocity_east_mps))
                P = np.full((6, 6), np.inf) if s.covariance is None else s.covariance
                self.squares.append((*P[:2, :2].ravel().tolist(), *P[2:4, 2:4].ravel().tolist()))
            case Plan() as s if node == "controller":
                self._planned(s, message.received_t_ns)
            case Applied() as s:
                if s.plan_sequence >= 0:
                    self.gate.append(GateSeen(s.t_ns, s.plan_received_t_ns, s.plan_cycle_t_ns, s.health))
                self.propeller_thrust.append((s.t_ns, *s.thrust_N[:2]))
                self.applied.append((s.t_ns, self._bad(s), s.plan_epoch, s.plans_rejected, s.plans_late))
            case RejectedFrame() as s:
                self.rejected.append((message.received_t_ns, node, s.key))
            case ModelCheck() as s:
                self.alarms.append((message.received_t_ns, s.alarm))
                if s.alarm and "[reference_point]" in s.why:
                    self.named_points.append(message.received_t_ns)
            case LocalisationReport() as s:
                wrong = {x.sensor: x.status for x in s.sensors if x.status is not SensorStatus.OK}
                self.reports.append(ReportSeen(s.t_ns, s.status is FilterStatus.NOMINAL, wrong))
            case _:
                pass

    def _planned(self, plan: Plan, at_ns: int) -> None:
        finite = bool(np.isfinite(plan.thrust_N).all())
        seen = PlanSeen(at_ns, plan.cycle_t_ns, plan.origin, plan.health, plan.health_why, finite)
        self.plans.append(seen)
        if plan.reference_m is not None:
            self.target.append((plan.cycle_t_ns, plan.reference_m))

    def _bad(self, applied: Applied) -> bool:
        """Return True if the command in force is outside box or slew limits, or not finite."""
        command, slew = np.array(applied.command_N), np.array(applied.command_slew_N_per_s)
        inside = (command >= self._box[:, 0]) & (command <= self._box[:, 1]) & (slew <= self._slew + SLEW_ROUNDING)
        return not bool(inside.all() and np.isfinite(applied.thrust_N).all())


class ReaderValidators:
    """Message validators, one for each reader as in processes: they decode damaged bytes and check sequence numbers."""

    def __init__(self) -> None:
        self._validators: dict[str, MessageValidator] = {}
        self.accepted: list[int] = []
        """Times (ns) at which a damaged frame was accepted, because its content was valid."""

    def receive(self, reader: str, delivery: Delivery) -> ReceivedMessage | str:
        """Return the accepted message, or the reason why it is rejected."""
        message, kind = delivery.message, type(delivery.message.message)
        validator = self._validators.setdefault(reader, MessageValidator())
        key, received_us = topics.key_of(kind, reader), delivery.at_ns // 1000
        try:
            if delivery.payload is not None:
                signal, header = validator.validate(Frame(topics.BY_TYPE[kind], key, delivery.payload, received_us))
                self.accepted.append(delivery.at_ns)
                return ReceivedMessage(signal, header.epoch, header.sequence, delivery.at_ns)
            if (reason := rejection_reason(message.message)) is not None:
                return reason
            validator.check_order(topics.BY_TYPE[kind], key, _header(message), received_us)
        except wire.WireError as error:
            return str(error)
        return message

    @property
    def dropped(self) -> int:
        """Return the number of messages that the validators know to be lost."""
        return sum(validator.dropped for validator in self._validators.values())


class Bus(MessageFaults):
    """Message transport with the bytes, the validators and the publishers of the bus.

    A second commander, a second source of estimates and a restarted controller are processes of their own.
    """

    def __init__(
        self,
        faults: Sequence[MessageFaultInterval],
        second_sources: Sequence[SecondSource] = (),
        antennas: Sequence[Antenna] = (),
        clock_steps: Sequence[ClockStepFault] = (),
        restarts: Callable[[int], int] = lambda _t_ns: 0,
    ) -> None:
        """``restarts`` returns the number of the controller's restarts until a time (ns)."""
        self.validators = ReaderValidators()
        self.second_estimates = [0] * len(second_sources)
        """Number of messages that each second source has published."""
        self._second_sources = second_sources
        self._antennas = antennas
        self._clock = OwnClock(clock_steps, epoch=EPOCH)
        self._restarts = restarts
        super().__init__(faults, encode=encoded, receive=self.validators.receive)

    def carry(self, writer: str, reader: str, message: ReceivedMessage) -> Sequence[Delivery]:
        """Deliver a message with the epoch of its writer."""
        if writer == world.Intruder.name:
            message = msgspec.structs.replace(message, epoch=INTRUDERS_EPOCH)
        elif writer == "controller":
            restarts = self._restarts(message.received_t_ns)
            message = msgspec.structs.replace(message, epoch=message.epoch + RESTARTED_EPOCH * restarts)
        for antenna in self._antennas:
            message = antenna.moved(message)
        deliveries = [d for each in self._clock.carry(writer, reader, message) for d in self._harmed(each)]
        for i, source in enumerate(self._second_sources):
            if reader == "controller" and (second := source.message(message)) is not None:
                self.second_estimates[i] += 1
                deliveries.append(Delivery(second.received_t_ns, second))
        return deliveries

    def _harmed(self, delivery: Delivery) -> Sequence[Delivery]:
        """Return the deliveries of one delivery, with the message faults."""
        return super().carry("", "", delivery.message)


def encoded(message: ReceivedMessage) -> bytes:
    """Encode a message as it travels on the bus."""
    return wire.encode(message.message, _header(message))


def _header(message: ReceivedMessage) -> wire.Header:
    return wire.Header(epoch=message.epoch, sequence=message.sequence, sent_monotonic_us=0)


class Observed(NamedTuple):
    """Outcome of one run: observations, messages harmed by each fault, and an uncontrolled end if there was one."""

    log: Log
    harmed: dict[int, int]  # by the fault's place in the run
    accepted: list[int] | None  # damaged frames: when; None: nobody looked
    dropped: list[tuple[int, int]]  # time, and number of losses that the validators knew of
    uncontrolled: str
    until_ns: int
    lost_plans: int = 0  # plans that were published and lost on the way to the observer


def run_config(run: Run) -> RunConfig:
    """Resolve the scenario with the run's seed and duration."""
    settings = (f"run.seed={run.seed}", f"run.duration_s={run.duration_s}", f"run.surface_time_s={run.afloat_s}")
    return resolve(SCENARIO, [Override("campaign", settings)])


def observe(run: Run, *, tap: Callable[[Message], None] = lambda _: None) -> Observed:
    """Make the run in this process. ``tap`` receives every published message."""
    of = run_config(run)
    log = Log(of.vehicle, tap=tap)
    now = SolverClock()
    harmed = [(i, harm) for i, fault in enumerate(run.faults) if (harm := _harm(fault)) is not None]
    second_sources = [
        (i, source) for i, fault in enumerate(run.faults) if (source := _second_source(fault)) is not None
    ]
    nodes = _nodes(of, run.faults, now)
    bus = Bus(
        [harm for _, harm in harmed],
        [source for _, source in second_sources],
        [antenna for fault in run.faults if (antenna := _antenna(fault)) is not None],
        [ClockStepFault(_interval(f), round(f.size * 1e9)) for f in run.faults if f.kind == "clock_step"],
        restarts=lambda t_ns: sum(f.kind == "controller_restart" and f.end_s * 1e9 <= t_ns for f in run.faults),
    )
    lockstep = LockStep(
        nodes,
        start_ns=of.scenario.start_ns,
        compute_delay_ns=_overrun(run.faults),
        observation=Observation(log, on_step=log.stepped),
        latest=lockstep_run.LATEST,
        make_rejection=lockstep_run.rejected_message,
        transport=bus,
    )
    uncontrolled, until_ns = "", of.scenario.end_ns
    dropped: list[tuple[int, int]] = []
    try:
        for t_ns in (*range(of.scenario.start_ns, of.scenario.end_ns, POLL_NS), of.scenario.end_ns):
            lockstep.advance(t_ns)
            dropped.append((t_ns, bus.validators.dropped))
    except Exception as error:  # whatever it is: that is what is looked for
        uncontrolled = f"{type(error).__name__}: {error}"
        until_ns = log.truth[-1][0] if log.truth else of.scenario.start_ns
    return Observed(
        log=log,
        harmed={
            **dict(zip((i for i, _ in harmed), bus.harmed, strict=True)),
            **dict(zip((i for i, _ in second_sources), bus.second_estimates, strict=True)),
        },
        accepted=bus.validators.accepted,
        dropped=dropped,
        uncontrolled=uncontrolled,
        until_ns=until_ns,
    )


def _nodes(of: RunConfig, faults: Sequence[Fault], now: SolverClock) -> list[Node]:
    """Return the nodes of the run, with the faulty components around them and the disturbances first."""
    solver_faults = [fault for fault in map(_solver_fault, faults) if fault is not None]
    make_solver = faulty_solvers(solver_faults, now)
    plant, sensors, *others, _ = make_nodes(of, make_solver=make_solver)
    restarts = [_interval(fault) for fault in faults if fault.kind == "controller_restart"]
    controller = RestartedNode(lambda: make_nodes(of, make_solver=make_solver)[-1], restarts)
    broken = [b for b in map(_broken, faults) if b is not None]
    disturbances = [d for fault in faults if (d := _disturbance(fault)) is not None]
    intrusions = [
        world.Intrusion(_interval(fault), world.thrust_at(of.vehicle, (fault.size, -fault.size, 0.0)))
        for fault in faults
        if fault.kind == "second_commander"
    ]
    return [
        world.DisturbanceSource(disturbances),
        world.Intruder(intrusions),
        plant,
        FaultySensors(sensors, broken),
        *others,
        TimedNode(controller, now),
    ]


def _interval(fault: Fault) -> Interval:
    return Interval(round(fault.start_s * 1e9), round(fault.end_s * 1e9))


def _broken(fault: Fault) -> SensorFault | None:
    what, _, failure = fault.kind.partition("_")
    if what != "sensor":
        return None
    return SensorFault(INSTRUMENTS[fault.target], Failure(failure), _interval(fault), fault.size, fault.seed)


def _harm(fault: Fault) -> MessageFaultInterval | None:
    harm = "loss" if fault.kind == "estimate_dropout" else fault.kind.removeprefix("message_")
    if harm not in set(MessageFault):
        return None
    return MessageFaultInterval(MESSAGES[fault.target], MessageFault(harm), _interval(fault), fault.size, fault.seed)


def _antenna(fault: Fault) -> Antenna | None:
    if fault.kind != "reference_point":
        return None
    ahead = fault.target == "ahead"
    point = ReferencePoint(forward_m=fault.size if ahead else 0.0, starboard_m=0.0 if ahead else fault.size)
    return Antenna(_interval(fault), point)


def _second_source(fault: Fault) -> SecondSource | None:
    if fault.kind != "second_source":
        return None
    towards = np.random.default_rng(fault.seed).uniform(0.0, 2.0 * np.pi)
    return SecondSource(_interval(fault), (fault.size * float(np.cos(towards)), fault.size * float(np.sin(towards))))


def _solver_fault(fault: Fault) -> SolverFaultInterval | None:
    return SolverFaultInterval(SolverFault(fault.target), _interval(fault)) if fault.kind == "solver_failure" else None


def _disturbance(fault: Fault) -> tuple[int, Disturbance] | None:
    start_ns, end_ns = _interval(fault)
    if fault.kind == "thruster_loss":
        left = 1.0 - fault.size
        scale = {"port": (left, 1.0, 1.0), "starboard": (1.0, left, 1.0), "both": (left, left, 1.0)}[fault.target]
        return start_ns, Disturbance(end_t_ns=end_ns, thrust_scale=scale)
    if fault.kind == "external_force":
        towards = np.random.default_rng(fault.seed).uniform(0.0, 2.0 * np.pi)
        force = (fault.size * float(np.cos(towards)), fault.size * float(np.sin(towards)), 0.0)
        return start_ns, Disturbance(end_t_ns=end_ns, force_N=force)
    return None


def _overrun(faults: Sequence[Fault]) -> Callable[[int], int]:
    """Return a function that gives the computing time (ns) of a cycle by its start."""
    slow = [(_interval(fault), round(fault.size * 1e9)) for fault in faults if fault.kind == "solver_overrun"]

    def delay_ns(t_ns: int) -> int:
        return next((delay for interval, delay in slow if interval.contains(t_ns)), 0)

    return delay_ns
