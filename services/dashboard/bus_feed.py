"""Bus connection of the live page: every plan and event, the newest of all other messages; heartbeats go out."""

from __future__ import annotations

import contextlib
import time
from typing import Any

import msgspec

from ltv_mpc.messages import (
    Applied,
    Clock,
    ClockState,
    ControllerStatus,
    Estimate,
    Heartbeat,
    LocalisationReport,
    Message,
    NodeSettings,
    NodeStatus,
    Plan,
    Truth,
)
from ltv_mpc.vehicle.parameters import Vehicle
from services.bus.mailbox import Frame, LatestCache, Mailbox
from services.bus.outbox import Outbox, new_epoch
from services.bus.session import Session
from services.bus.topics import BY_TYPE, OPERATOR, expression
from services.bus.wire import Header
from services.dashboard.late_joining import HistoryQuery
from services.reporting.plots.collector import EVERY, NEWEST, Collector
from services.reporting.safety import process_state
from services.runtime.clock import ClockError, VehicleClock, monotonic_us
from services.supervisor.screen import in_order

WAITING = 200
"""Queue length of the messages of ``EVERY`` between two updates; at 20 times real time there are 14."""


OF_PLAN = ("authority", "health", "health_why", "origin", "why", "fence")
OF_CONTROLLER = ("source", "progress", "arrived")
OF_STATUS = ("steps", "step_us", "dropped", "rejected")
"""Fields of messages that the page shows as they are."""


class PageStatus(msgspec.Struct, frozen=True, kw_only=True):
    """Status shown by the page. Ages are vehicle time from the validity of a message to now."""

    run: int  # number of the run
    name: str  # of the vehicle; empty if it publishes no settings
    t_s: float | None
    clock: str  # waiting, running, paused; "own" without a clock message, "silent" without any time
    speed: float  # of the clock, times real time
    requested_speed: float  # larger than ``speed`` if the machine cannot keep it
    plan: dict[str, Any]  # ``OF_PLAN`` of the newest one; empty if there is none
    health_s: float | None  # since which time, from ``t_s``'s zero; None: unknown
    controller: dict[str, Any]  # ``OF_CONTROLLER`` of its newest status; empty if there is none
    error_m: float | None  # estimate from the reference
    true_error_m: float | None  # vehicle from the reference, since the start; None without a known truth
    depth_m: float | None
    heading_rad: float | None
    ages_s: dict[str, float | None]
    processes: list[dict[str, Any]]  # name, state, wall time since its last status (s), and ``OF_STATUS`` of that
    simulated: bool  # the true state is published
    preparation: str  # what a run prepares before it starts its processes


class BusFeed:
    """Receiver of the messages of ``session``. Call ``update`` about ten times a second, from one thread."""

    def __init__(self, session: Session, vehicle: Vehicle | None) -> None:
        self._vehicle = vehicle
        self.collector = Collector(vehicle)
        self.run = 0
        """Number of the run. A new run on the same keys increases it; the collected data are then dropped."""
        self.preparation = ""
        """What a run prepares before it starts its processes; empty if unknown."""
        self._newest = LatestCache()
        self._every = Mailbox(WAITING)
        self._seen: dict[str, Frame] = {}
        self._processes: dict[str, tuple[NodeStatus, float]] = {}
        self._clock = VehicleClock()
        self._heartbeats = Outbox(session, node=OPERATOR, epoch=new_epoch(), kinds=(Heartbeat,))
        for kind in (*NEWEST, *EVERY, NodeStatus, NodeSettings):
            topic = BY_TYPE[kind]
            inlet = self._every if kind in EVERY else self._newest
            session.subscribe(expression(topic), topic, inlet)
        self._history = HistoryQuery(session)

    def beat(self) -> None:
        """Publish a heartbeat: an operator has the page open.

        Nobody reads it before a process has published its status, and a recorder that starts later would report a loss.
        """
        if self._processes:
            self._heartbeats.publish(Heartbeat())

    def update(self) -> None:
        """Process the messages received since the last call; nothing while the history is awaited."""
        if self._history.awaited:
            return
        past = self._history.take()
        if past:
            self._reset()  # the history has what was received before it was asked
            self._seen.clear()
        for message, header in past:
            self._receive(message, header, time.monotonic())
        for newest in sorted(self._newest.frames(), key=_clock_first):
            if self._seen.get(newest.key) is not newest:
                self._seen[newest.key] = newest
                if newest.decoded is not None:
                    self._receive(*newest.decoded, newest.arrived_s)
        while (frame := self._every.take(0.0)) is not None:
            if frame.decoded is not None and not self._history.had(*frame.decoded):
                self._receive(*frame.decoded, 0.0)
        if "since_s" in self.collector.values:
            self._history = self._history.again()

    def status(self) -> PageStatus:
        """Return the current status."""
        newest = self.collector.newest
        clock, controller, plan = newest(Clock), newest(ControllerStatus), newest(Plan)
        estimate, applied = newest(Estimate), newest(Applied)
        t_ns = self.t_ns()
        ages = {
            "estimate": _age(t_ns, None if estimate is None else estimate.t_ns),
            "plan": _age(t_ns, None if plan is None else plan.cycle_t_ns),
            "actuators": _age(t_ns, None if applied is None else applied.t_ns),
        }
        if (localisation := newest(LocalisationReport)) is not None:
            ages |= {report.sensor: _age(t_ns, report.last_t_ns) for report in localisation.sensors}
        state = "silent" if clock is None else clock.state.value
        known = self.collector.vehicle
        return PageStatus(
            run=self.run,
            name="" if known is None else f"vehicle {known.name}",
            t_s=None if t_ns is None else self.collector.seconds(t_ns),
            clock="own" if clock is None and t_ns is not None else state,
            speed=1.0 if clock is None else clock.speed_num / clock.speed_den,
            requested_speed=1.0 if clock is None else clock.requested_speed,
            plan={} if plan is None else {name: getattr(plan, name) for name in OF_PLAN},
            health_s=self.collector.marks.since_s.get("health"),
            controller={} if controller is None else {name: getattr(controller, name) for name in OF_CONTROLLER},
            error_m=self.collector.error_m,
            true_error_m=self.collector.true_error_m,
            depth_m=None if estimate is None else estimate.depth_m,
            heading_rad=None if estimate is None else estimate.heading_rad,
            ages_s=ages,
            processes=self._process_rows(paused=clock is not None and clock.state is ClockState.PAUSED),
            simulated=newest(Truth) is not None,
            preparation=self.preparation,
        )

    def t_ns(self) -> int | None:
        """Return the vehicle time now (ns); without a clock, the time of the newest estimate."""
        reading = self._clock.read(monotonic_us())
        estimate = self.collector.newest(Estimate)
        return estimate.t_ns if reading is None and estimate is not None else reading

    def _receive(self, message: Message, header: Header, came_s: float) -> None:
        controller = self.collector.newest(ControllerStatus)
        if isinstance(message, Estimate) and controller is not None and header.epoch != controller.source_epoch != 0:
            return  # of another source than the one in use
        if isinstance(message, Clock):
            self._receive_clock(message)
        if isinstance(message, NodeStatus):
            self._processes[message.node] = (message, came_s)
        self.collector.add(message, header.epoch)

    def _receive_clock(self, clock: Clock) -> None:
        newest = self.collector.newest(Clock)
        if newest is not None and newest.clock_epoch != clock.clock_epoch:
            self._reset()
        with contextlib.suppress(ClockError):  # the clock of another host: use the time of the estimates
            self._clock.follow(clock)

    def _reset(self) -> None:
        self.run += 1
        self.collector = Collector(self._vehicle)
        self._clock = VehicleClock()
        self._processes.clear()

    def _process_rows(self, *, paused: bool) -> list[dict[str, Any]]:
        now_s, rows = time.monotonic(), []
        for name, (status, came_s) in in_order(self._processes):
            state = "paused" if paused and not status.finished else process_state(status)
            row = {"name": name, "state": state, "silent_s": round(now_s - came_s, 2)}
            rows.append(row | {field: getattr(status, field) for field in OF_STATUS})
        return rows


def _clock_first(frame: Frame) -> tuple[bool, bool, str]:
    """Return a sort key: clock, then truth, then the rest, so that the start error has a truth for its estimate."""
    kind = frame.topic and frame.topic.message_type
    return kind is not Clock, kind is not Truth, frame.key


def _age(t_ns: int | None, then_ns: int | None) -> float | None:
    return None if t_ns is None or then_ns is None else round((t_ns - then_ns) / 1e9, 3)
