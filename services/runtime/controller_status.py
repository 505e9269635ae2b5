"""Controller status, published once a second: input ages, cycle times, rejections, authority, health, error (m)."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable, Sequence

from ltv_mpc.control.node import ControllerNode
from ltv_mpc.errors import with_reason
from ltv_mpc.messages import (
    Applied,
    ClockMode,
    ClockStep,
    ControllerStatus,
    Message,
    MissionAction,
    Plan,
    RunEvent,
)
from ltv_mpc.node import DEFAULT_SOURCE
from ltv_mpc.safety.health import HealthState
from services.bus.message_validation import MessageValidator
from services.runtime.clock_offset import ClockOffset
from services.runtime.console import Tell
from services.runtime.controller_changes import ControllerChanges
from services.runtime.node_io import SavedState

PERIOD_US = 1_000_000
"""Time between two statuses (us)."""
CYCLE_WINDOW_US = 10_000_000
"""Window over which cycle times are evaluated (us)."""

StatusSink = Callable[[ControllerStatus], None]
"""Consumer of each status besides the bus."""


class ControllerStatusReporter:
    """Reporter of the controller's status on the bus, and to each sink: the status line, the metrics, the changes."""

    def __init__(
        self,
        node: ControllerNode,
        sinks: Sequence[StatusSink] = (),
        tell: Tell = lambda *_, **__: None,
        saved: SavedState | None = None,
    ) -> None:
        self._node = node
        self._saved = saved
        self._changes = ControllerChanges(tell)
        self._sinks = sinks
        self._plan: Plan | None = None
        self._applied_ns: int | None = None
        self._clock_steps = 0
        self._mission_action = MissionAction.GO_ON
        self._cycles: deque[tuple[int, int]] = deque()  # end and duration of each (us)
        self.due_us = 0

    def on_input(self, message: Message) -> None:
        """Record an accepted input."""
        self._changes.on_message(message)
        match message:
            case Applied():
                self._applied_ns = message.t_ns
            case ClockStep():
                self._clock_steps += 1
            case _:
                pass

    def on_step(self, outputs: Sequence[Message], took_us: int, now_us: int) -> list[RunEvent]:
        """Record a step whose outputs were published; return an event for each change of mission policy and fence."""
        events: list[RunEvent] = []
        for message in outputs:
            if isinstance(message, Plan):
                if self._plan is None or message.health_why != self._plan.health_why:
                    self.due_us = 0  # screens with the status alone show it at once, too
                self._plan = message
                self._cycles.append((now_us, took_us))
                mission, t_ns, node = self._node.mission.state, message.cycle_t_ns, self._node.name
                if mission.action is not self._mission_action:
                    text = with_reason(f"mission: {mission.action.value}", mission.why)
                    events.append(RunEvent(t_ns=t_ns, node=node, kind="mission", text=text))
                self._mission_action = mission.action
            events += self._changes.on_message(message)
        return events

    def status(self, now_us: int, t_ns: int, validator: MessageValidator, clock: ClockOffset) -> ControllerStatus:
        """Return the status that is due, and pass it to the sinks."""
        self.due_us = now_us + PERIOD_US
        while self._cycles and self._cycles[0][0] < now_us - CYCLE_WINDOW_US:
            self._cycles.popleft()
        took_us = sorted(took for _, took in self._cycles)
        node = self._node
        estimate, sources = node.sources.newest, node.sources.selector
        second = sources.second(t_ns)
        rejected = Counter(validator.rejected_by_reason)
        if node.arbiter.manual_rejected:
            rejected["manual: thrust outside the limits"] = node.arbiter.manual_rejected
        health = node.health(t_ns)
        if self._plan is not None:
            health = HealthState(self._plan.health, self._plan.health_why)
        rejected.update({f"estimate: {why}": count for why, count in node.controller.estimate_gate.rejected.items()})
        status = ControllerStatus(
            t_ns=t_ns,
            estimate_age_ns=None if estimate is None else t_ns - estimate.t_ns,
            applied_age_ns=None if self._applied_ns is None else t_ns - self._applied_ns,
            cycle_median_us=_quantile(took_us, 0.5),
            cycle_p99_us=_quantile(took_us, 0.99),
            received=validator.received,
            dropped=validator.dropped,
            rejected=dict(rejected),
            clock=clock.mode,
            clock_error_ns=clock.error_ns,
            clock_steps=self._clock_steps,
            checkpoints_failed=0 if self._saved is None else self._saved.failures,
            authority=node.arbiter.authority,
            health=health.health,
            health_why=health.why,
            mission_action=node.mission.state.action,
            error_m=self._error_m(),
            progress=None if self._plan is None else self._plan.progress,
            arrived=self._plan is not None and self._plan.arrived,
            inputs=node.inputs(),
            source="" if sources.active is None else sources.active.name,
            source_epoch=0 if sources.active is None else sources.active.epoch,
            rejected_epoch=0 if second is None else second.epoch,
            rejected_estimates=sources.rejected,
        )
        self._changes.on_status(status)
        for sink in self._sinks:
            sink(status)
        return status

    def _error_m(self) -> float | None:
        """Return the distance of the vehicle's origin from its target, by the newest accepted estimate."""
        controller = self._node.controller
        estimate, target_m = controller.estimate_gate.accepted, controller.follower.target_m
        if self._plan is None or self._plan.reference_m is None or estimate is None or target_m is None:
            return None
        return math.dist((estimate.north_m, estimate.east_m), target_m)


def _quantile(ascending: Sequence[int], share: float) -> float | None:
    """Return a quantile of sorted values, rounded up to one of them; None if there are no values."""
    return float(ascending[math.ceil(share * (len(ascending) - 1))]) if ascending else None


def status_line(status: ControllerStatus, estimates_on: str) -> str:
    """Return a status in one line; ``estimates_on`` is the estimates' key, shown until the first one arrives."""
    health = f"{status.health.value} ({status.health_why})" if status.health_why else status.health.value
    parts = [status.authority.value, health]
    if status.estimate_age_ns is None:
        parts.append(f"no estimate yet on {estimates_on}")
    else:
        parts.append(f"estimate {status.estimate_age_ns / 1e9:.2f} s old")
        if status.applied_age_ns is None:
            parts.append("no `applied` messages: plans count as followed")
    if status.cycle_median_us is not None and status.cycle_p99_us is not None:
        parts.append(f"cycle {status.cycle_median_us / 1e3:.1f} ms (p99 {status.cycle_p99_us / 1e3:.1f})")
    if status.source not in ("", DEFAULT_SOURCE):
        parts.append(f"source {status.source}")
    if status.error_m is not None:
        parts.append(f"error {status.error_m:.2f} m")
    if status.progress is not None:
        parts.append(f"{100 * status.progress:.0f} % of the path")
    if status.arrived:
        parts.append("arrived")
    if status.clock is not ClockMode.SHARED:
        error = "" if status.clock_error_ns is None else f", within {status.clock_error_ns / 1e6:.1f} ms"
        steps = f", steps: {status.clock_steps}" if status.clock_steps else ""
        parts.append(f"clock {status.clock.value}{error}{steps}")
    if status.checkpoints_failed:
        parts.append(f"{status.checkpoints_failed} checkpoints not written")
    if status.dropped or status.rejected:
        parts.append(f"{status.dropped} dropped, {sum(status.rejected.values())} rejected")
    return " | ".join(parts)
