"""Bus monitor: the newest message of each key, decoded once, when it is first read, and the view for the screen."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple, TypeVar, cast

import msgspec

from ltv_mpc.messages import (
    Applied,
    Clock,
    ClockState,
    ControllerState,
    ControllerStatus,
    CycleTiming,
    Estimate,
    EstimatorState,
    Kill,
    LocalisationReport,
    Message,
    NodeStatus,
    Plan,
    RunEvent,
    Truth,
)
from ltv_mpc.node import DEFAULT_SOURCE
from services.bus.mailbox import LatestCache, Mailbox
from services.bus.roles import ROUTER
from services.bus.session import Session
from services.bus.topics import BY_TYPE, STATES, expression
from services.bus.wire import Header, encode, epoch_of
from services.runtime.clock import ClockError, VehicleClock, monotonic_us
from services.supervisor.screen import LiveView

S = TypeVar("S", bound=Message)
STATUS = BY_TYPE[NodeStatus].key

DISPLAYED: dict[str, type[Message]] = {
    "truth": Truth,
    "localisation": LocalisationReport,
    "plan": Plan,
    "applied": Applied,
    "controller": ControllerStatus,
    "timing": CycleTiming,
}
"""Types of which the view has the newest message, by its field."""

OTHERS: tuple[type[Message], ...] = (Clock, Estimate, ControllerState, EstimatorState)


class Activity(NamedTuple):
    """Newest message that shows that a process does its work."""

    epoch: int  # of the process; 0 for the router, which has none
    arrived_s: float  # monotonic time


class BusMonitor:
    """Subscriptions of the supervisor. ``nodes`` are the processes whose status it reads; ``*`` reads all."""

    def __init__(self, session: Session, nodes: Iterable[str]) -> None:
        self._newest = LatestCache()
        self._notices = Mailbox()
        self._clock = VehicleClock()
        for kind in (*DISPLAYED.values(), *OTHERS):
            session.subscribe(expression(BY_TYPE[kind]), BY_TYPE[kind], self._newest)
        for node in nodes:
            session.subscribe(f"{STATUS}/{node}", BY_TYPE[NodeStatus], self._newest)
        session.subscribe(f"{BY_TYPE[RunEvent].key}/*", BY_TYPE[RunEvent], self._notices)
        session.subscribe(BY_TYPE[Kill].key, BY_TYPE[Kill], self._notices)

    def newest(self, kind: type[S], node: str = "") -> S | None:
        """Return the newest message of this type, or None.

        ``node`` is the last part of its key: the process if every process writes it, the source of an estimate.
        """
        key = f"{BY_TYPE[kind].key}/{node}" if node else BY_TYPE[kind].key
        frame = self._newest.get(key)
        found = None if frame is None else frame.decoded
        return found[0] if found is not None and isinstance(found[0], kind) else None

    def plan_in_force(self) -> Plan | None:
        """Return the plan that the actuators have accepted last; None if it has not been received."""
        applied = self.newest(Applied)
        if applied is None or applied.plan_sequence < 0:
            return None
        for frame in self._newest.recent(BY_TYPE[Plan].key):
            if frame.decoded is not None:
                plan, header = frame.decoded
                if (header.epoch, header.sequence) == (applied.plan_epoch, applied.plan_sequence):
                    return cast(Plan, plan)
        return None

    def restore_state(self, node: str) -> bytes:
        """Return the encoded state that a new process of this name continues from; empty if there is none.

        It is the newest state that the failed process has published, updated with newer messages: the newest estimate,
        and for a controller the plan that the actuators follow. No other process publishes these while the process is
        dead.
        """
        kind = STATES.get(node)
        state = None if kind is None else self.newest(kind)
        if state is None:
            return b""
        state = msgspec.structs.replace(state, estimate=self.newest(Estimate) or state.estimate)
        if isinstance(state, ControllerState):
            state = msgspec.structs.replace(state, plan=self.plan_in_force())
        return encode(state, Header(epoch=0, sequence=0))

    def nodes(self) -> list[str]:
        """Return the processes that have published a status."""
        keys = (frame.key for frame in self._newest.frames() if frame.topic is BY_TYPE[NodeStatus])
        return sorted(key.removeprefix(f"{STATUS}/") for key in keys)

    def running(self) -> bool:
        """Return True if the vehicle clock runs."""
        clock = self.newest(Clock)
        return clock is not None and clock.state is ClockState.RUNNING

    def last_activity(self, node: str) -> Activity | None:
        """Return the newest message that shows that ``node`` works; None if there is none.

        While the clock runs, an estimator shows it by an estimate and a controller by a plan that the actuators have
        accepted. All other processes, and these two while the clock is paused, show it by their status. The router
        publishes none: any message that came through it counts.
        """
        if node == ROUTER:
            return Activity(0, self._newest.arrived_s)
        if node == "controller" and self.running():
            applied, frame = self.newest(Applied), self._newest.get(BY_TYPE[Applied].key)
            return None if applied is None or frame is None else Activity(applied.plan_epoch, frame.arrived_s)
        key = BY_TYPE[Estimate].key if node == "estimator" and self.running() else f"{STATUS}/{node}"
        frame = self._newest.get(key)
        epoch = None if frame is None else epoch_of(frame.payload)
        return None if frame is None or epoch is None else Activity(epoch, frame.arrived_s)

    def notices(self) -> Iterator[Message]:
        """Yield the run events and an operator's kill requests since the last call; invalid frames are skipped."""
        while (frame := self._notices.take(0.0)) is not None:
            if frame.decoded is not None:
                yield frame.decoded[0]

    def t_ns(self) -> int | None:
        """Return the vehicle time; None while it is not known."""
        if (message := self.newest(Clock)) is not None:
            try:
                self._clock.follow(message)
            except ClockError:
                return None
        return self._clock.read(monotonic_us())

    def view(
        self, states: Mapping[str, str], wall_s: float, *, start_ns: int = 0, end_ns: int | None = None
    ) -> LiveView:
        """Return the view of this moment. ``states`` are the states of the processes, by name.

        ``start_ns`` and ``end_ns`` bound the vehicle time of a run; a vehicle has neither.
        """
        clock, controller, t_ns = self.newest(Clock), self.newest(ControllerStatus), self.t_ns()
        source = DEFAULT_SOURCE if controller is None else controller.source
        estimate = self.newest(Estimate, "" if source == DEFAULT_SOURCE else source)
        if t_ns is None:
            t_ns = start_ns if clock is not None or estimate is None else estimate.t_ns
        newest: dict[str, Any] = {field: self.newest(kind) for field, kind in DISPLAYED.items()}
        return LiveView(
            **newest,
            estimate=estimate,
            t_ns=t_ns if end_ns is None else min(t_ns, end_ns),
            start_ns=start_ns,
            end_ns=end_ns,
            speed=1.0 if clock is None else clock.speed_num / clock.speed_den,
            requested_speed=1.0 if clock is None else clock.requested_speed,
            wall_s=wall_s,
            phase=_phase(clock, t_ns, end_ns),
            status={name: status for name in states if (status := self.newest(NodeStatus, name)) is not None},
            state=states,
        )


def _phase(clock: Clock | None, t_ns: int, end_ns: int | None) -> str:
    if clock is None:
        return "" if end_ns is None else "starting"
    if clock.state is ClockState.WAITING:
        return "starting"
    if clock.state is ClockState.PAUSED:
        return "stopping" if end_ns is not None and t_ns >= end_ns else "paused"
    return "afloat" if t_ns < 0 else "diving"
