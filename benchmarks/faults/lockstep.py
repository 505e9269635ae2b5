"""Fault injection in lock step: one run with its faults, and the observations from its messages."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import msgspec
import numpy as np

from benchmarks.faults import world
from benchmarks.faults.draw import Run
from benchmarks.faults.effects import (
    Antenna,
    Interval,
    RestartedNode,
    SecondSource,
    SolverClock,
    SolverFault,
    SolverFaultInterval,
    TimedNode,
    faulty_solvers,
)
from benchmarks.faults.figures import OwnKeys, Witness
from benchmarks.faults.kinds import INSTRUMENTS, MESSAGES, Fault
from benchmarks.faults.log import INTRUDERS_EPOCH, Case, Log, Observed, lost_between
from benchmarks.faults.message_faults import (
    Delivery,
    FaultyLockStep,
    MessageFault,
    MessageFaultInterval,
    MessageFaults,
)
from benchmarks.faults.own_clock import ClockStepFault, OwnClock
from benchmarks.faults.sensor_faults import Failure, FaultySensors, SensorFault
from ltv_mpc.messages import Disturbance, Message, Plan
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
from sim.scheduler import EPOCH, Observation, Observer

T = TypeVar("T")
SCENARIO = "hover"

RESTARTED_EPOCH = 100
"""Difference between the epochs of a controller and of the one that replaces it."""

POLL_NS = 500_000_000
"""Time between two readings of the validators' counts."""


class SlowCycles(NamedTuple):
    """Interval in which a cycle takes so long to compute."""

    interval: Interval
    delay_ns: int


def part_of(fault: Fault, vehicle: Vehicle) -> Any:
    """Return the part that a fault makes faulty: messages to publish, each with its time, or what harms others."""
    interval, size = Interval(fault.start_ns, fault.end_ns), fault.size
    towards = np.random.default_rng(fault.seed).uniform(0.0, 2.0 * np.pi)
    push = size * float(np.cos(towards)), size * float(np.sin(towards))
    what, _, how = fault.kind.partition("_")
    match fault.kind:
        case "solver_failure":
            return SolverFaultInterval(SolverFault(fault.target), interval)
        case "solver_overrun":
            return SlowCycles(interval, round(size * 1e9))
        case "thruster_loss":
            port, starboard = (1.0 - size if fault.target in (side, "both") else 1.0 for side in ("port", "starboard"))
            return [(fault.start_ns, Disturbance(end_t_ns=fault.end_ns, thrust_scale=(port, starboard, 1.0)))]
        case "external_force":
            return [(fault.start_ns, Disturbance(end_t_ns=fault.end_ns, force_N=(*push, 0.0)))]
        case "second_commander":
            return world.intrusion(interval, world.thrust_at(vehicle, (size, -size, 0.0)))
        case "second_source":
            return SecondSource(interval, push)
        case "reference_point":
            ahead, starboard = (size, 0.0) if fault.target == "ahead" else (0.0, size)
            return Antenna(interval, ReferencePoint(forward_m=ahead, starboard_m=starboard))
        case "clock_step":
            return ClockStepFault(interval, round(size * 1e9))
        case "controller_restart":
            return interval
        case "own_keys":
            return OwnKeys(MESSAGES[fault.target], interval, size, fault.seed)
        case _ if what == "sensor":
            return SensorFault(INSTRUMENTS[fault.target], Failure(how), interval, size, fault.seed)
        case _:
            harm = {"estimate_dropout": "loss"}.get(fault.kind, fault.kind.removeprefix("message_"))
            return MessageFaultInterval(MESSAGES[fault.target], MessageFault(harm), interval, size, fault.seed)


class Parts:
    """Faulty parts of a run, each with the fault that it comes from."""

    def __init__(self, faults: Sequence[Fault], vehicle: Vehicle) -> None:
        self._made = {fault: part_of(fault, vehicle) for fault in faults}
        self._slow = self.of(SlowCycles).values()

    def of(self, kind: type[T]) -> dict[Fault, T]:
        """Return the parts of one type."""
        return {fault: part for fault, part in self._made.items() if type(part) is kind}

    def compute_delay_ns(self, t_ns: int) -> int:
        """Return the computing time (ns) of a cycle that starts at ``t_ns``."""
        return next((slow.delay_ns for slow in self._slow if slow.interval.contains(t_ns)), 0)

    def nodes(self, of: RunConfig) -> list[Node]:
        """Return the nodes of the run, with the faulty components around them and the published messages first."""
        now = SolverClock()
        make_solver = faulty_solvers([*self.of(SolverFaultInterval).values()], now)
        plant, sensors, *others, _ = make_nodes(of, make_solver=make_solver)
        restarts = [*self.of(Interval).values()]
        controller = RestartedNode(lambda: make_nodes(of, make_solver=make_solver)[-1], restarts)
        script = [pair for messages in self.of(list).values() for pair in messages]
        return [
            *(
                world.Script(name, kind, [pair for pair in script if isinstance(pair[1], kind)])
                for name, kind in (("operator", Disturbance), (world.INTRUDER, Plan))
            ),
            plant,
            FaultySensors(sensors, [*self.of(SensorFault).values()]),
            *others,
            TimedNode(controller, now),
        ]


class Bus(MessageFaults):
    """Way of the messages with the bytes, the publishers and the message validators of the bus, one a reader.

    A second commander, a second source of estimates and a restarted controller are processes of their own.
    """

    def __init__(self, parts: Parts) -> None:
        self.accepted: list[int] = []
        """Times (ns) at which a damaged frame was accepted, because its content was valid."""
        self._messages, self._sources = parts.of(MessageFaultInterval), parts.of(SecondSource)
        self._own_keys = parts.of(OwnKeys).values()
        self._antennas, self._restarts = parts.of(Antenna).values(), parts.of(Interval).values()
        self._validators: dict[str, MessageValidator] = {}
        self._second_estimates = dict.fromkeys(self._sources, 0)
        self._clock = OwnClock([*parts.of(ClockStepFault).values()], epoch=EPOCH)
        super().__init__([*self._messages.values()], encode=encoded, receive=self._receive)

    @property
    def harmed_by(self) -> dict[Fault, int]:
        """Return the number of messages that each fault has harmed, or that a second source has published."""
        return dict(zip(self._messages, self.harmed, strict=True)) | self._second_estimates

    @property
    def dropped(self) -> int:
        """Return the number of messages that the validators know to be lost."""
        return sum(validator.dropped for validator in self._validators.values())

    def carry(self, writer: str, reader: str, message: ReceivedMessage) -> Sequence[Delivery]:
        """Deliver a message with the epoch of its writer."""
        if writer == world.INTRUDER:
            message = msgspec.structs.replace(message, epoch=INTRUDERS_EPOCH)
        elif writer == "controller":
            restarts = sum(dead.end_ns <= message.received_t_ns for dead in self._restarts)
            message = msgspec.structs.replace(message, epoch=message.epoch + RESTARTED_EPOCH * restarts)
        for antenna in self._antennas:
            message = antenna.moved(message)
        heard = self._clock.carry(writer, reader, message)
        deliveries = [harmed for each in heard for harmed in super(Bus, self).carry("", "", each.message)]
        for fault, source in self._sources.items():
            if reader == "controller" and (second := source.message(message)) is not None:
                self._second_estimates[fault] += 1
                deliveries.append(Delivery(second.received_t_ns, second))
        false = [frame for own in self._own_keys for frame in own.frames(message)]
        return [*deliveries, *(Delivery(frame.received_t_ns, frame) for frame in false)]

    def _receive(self, reader: str, delivery: Delivery) -> ReceivedMessage | str:
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


def encoded(message: ReceivedMessage) -> bytes:
    """Encode a message as it travels on the bus."""
    return wire.encode(message.message, _header(message))


def _header(message: ReceivedMessage) -> wire.Header:
    return wire.Header(epoch=message.epoch, sequence=message.sequence, sent_monotonic_us=0)


def run_config(run: Run, *settings: str) -> RunConfig:
    """Resolve the scenario with the run's seed and duration. Raises ``ConfigError``."""
    times = f"run.seed={run.seed}", f"run.duration_s={run.duration_s}", f"run.surface_time_s={run.afloat_s}"
    return resolve(SCENARIO, [Override("campaign", (*times, *settings))])


def observe(run: Run, *, tap: Callable[[Message], None] = lambda _: None) -> tuple[Observed, list[Case]]:
    """Make the run in this process. ``tap`` receives every published message."""
    of = run_config(run)
    parts = Parts(run.faults, of.vehicle)
    log, own_keys = Log(of.vehicle, tap=tap), parts.of(OwnKeys)
    if not own_keys:
        observed, harmed, dropped = _lock_step(of, parts, log, log)
    else:
        with tempfile.TemporaryDirectory() as folder:
            witness = Witness(log, of, Path(folder, "run.mcap"), [*own_keys.values()])
            observed, harmed, dropped = _lock_step(of, parts, log, witness)
            observed = observed._replace(false_figures=witness.false_figures())
            harmed |= {fault: witness.sent[own] for fault, own in own_keys.items()}
    return observed, [
        Case(
            fault,
            fault.start_ns,
            fault.end_ns,
            observed,
            harmed=harmed.get(fault, 0),
            counted=lost_between(dropped, fault.start_ns, fault.end_ns),
        )
        for fault in run.faults
        if fault.start_ns < observed.until_ns
    ]


def _lock_step(
    of: RunConfig, parts: Parts, log: Log, observer: Observer
) -> tuple[Observed, dict[Fault, int], list[tuple[int, int]]]:
    """Make the run. Return what was observed, the messages that each fault harmed, and the count of lost ones."""
    bus = Bus(parts)
    lockstep = FaultyLockStep(
        bus,
        parts.nodes(of),
        start_ns=of.scenario.start_ns,
        compute_delay_ns=parts.compute_delay_ns,
        observation=Observation(observer, on_step=log.stepped),
        make_rejection=lockstep_run.rejected_message,
    )
    uncontrolled, until_ns = "", of.scenario.end_ns
    dropped: list[tuple[int, int]] = []
    try:
        for t_ns in (*range(of.scenario.start_ns, of.scenario.end_ns, POLL_NS), of.scenario.end_ns):
            lockstep.advance(t_ns)
            dropped.append((t_ns, bus.dropped))
    except Exception as error:  # whatever it is: that is what is looked for
        uncontrolled = f"{type(error).__name__}: {error}"
        until_ns = log.truth[-1][0] if log.truth else of.scenario.start_ns
    return Observed(log, until_ns, uncontrolled, bus.accepted), bus.harmed_by, dropped
