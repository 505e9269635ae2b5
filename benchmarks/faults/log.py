"""Observations of a run with faults from its messages, whether in lock step or from the recording of processes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from benchmarks.faults.effects import SECOND_EPOCH
from benchmarks.faults.kinds import Fault
from ltv_mpc.messages import (
    Applied,
    ClockStep,
    Estimate,
    FilterStatus,
    Health,
    LocalisationReport,
    Message,
    ModelCheck,
    Pair,
    Plan,
    PlanOrigin,
    RejectedFrame,
    SensorStatus,
    Truth,
)
from ltv_mpc.node import ReceivedMessage
from ltv_mpc.vehicle.parameters import Vehicle
from sim.scheduler import Step

INTRUDERS_EPOCH = 7
"""Epoch of the second commander's messages, which is another process than the controller."""

REPORT_NS = 1_000_000_000
"""Period of reports and counts."""

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
    alarms: list[tuple[int, bool]] = field(default_factory=list)  # model check: published, and whether an alarm
    propeller_thrust: list[tuple[int, float, float]] = field(default_factory=list)  # t, port and starboard (N)
    received_estimates: list[tuple[int, int]] = field(default_factory=list)  # by the controller: t received, t valid
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
            if isinstance(a.message, Estimate) and a.epoch != SECOND_EPOCH
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
                finite = bool(np.isfinite(s.thrust_N).all())
                at_ns = message.received_t_ns
                self.plans.append(PlanSeen(at_ns, s.cycle_t_ns, s.origin, s.health, s.health_why, finite))
                if s.reference_m is not None:
                    self.target.append((s.cycle_t_ns, s.reference_m))
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

    def _bad(self, applied: Applied) -> bool:
        """Return True if the command in force is outside box or slew limits, or not finite."""
        command, slew = np.array(applied.command_N), np.array(applied.command_slew_N_per_s)
        inside = (command >= self._box[:, 0]) & (command <= self._box[:, 1]) & (slew <= self._slew + SLEW_ROUNDING)
        return not bool(inside.all() and np.isfinite(applied.thrust_N).all())


class Reaction(NamedTuple):
    """Delay from when a reaction was due to the reaction, and why it was late; None: nothing was due, or it cannot be
    timed.
    """

    seconds: float | None
    late: str = ""


class Observed(NamedTuple):
    """Outcome of one run, without its faults."""

    log: Log
    until_ns: int
    uncontrolled: str = ""  # how it ended, where that was not to be
    accepted: Sequence[int] | None = None  # damaged frames whose content was valid: when; None: nobody looked
    false_figures: str = ""  # of the summary
    wait_s: float | None = None  # from a signal to the end of all processes


class Case(NamedTuple):
    """One fault in its run."""

    fault: Fault
    start_ns: int
    end_ns: int
    of: Observed
    harmed: int = 0  # messages
    counted: int = 0  # messages that their reader counted as lost meanwhile
    lost_plans: int = 0  # published, and harmed on the way to the observer
    back: Reaction | None = None  # of a process that was ended or stopped: when it was back, in wall time
    lost: int = 0  # further messages of the run that are lost, and that nobody counted


def lost_between(counts: Sequence[tuple[int, int]], start_ns: int, end_ns: int) -> int:
    """Return how much a count of lost messages (time, count) grew from a fault's start until two reports later."""
    before = [count for t, count in counts if t <= start_ns]
    after = [count for t, count in counts if t <= end_ns + 2 * REPORT_NS]
    return after[-1] - before[-1] if before else 0
