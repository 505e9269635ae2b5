"""Changes of a controller's state, each reported once: health, authority, source, fence, clocks, rejected messages.

state    reported when it changes, and once at the start: health with its reason, authority, source of the estimates
event    reported each time: a step of a publisher's clock, another fence in force, a zone or margin that the hull
enters or leaves, a plan that lacks clearance; the time until the hull is in a zone or obstacle, when it falls below
300, 60 and 20 s
count    reported at the first one, then at 10, 100, ...: rejected messages by reason, plans that the actuators
rejected, plans that arrived late
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

from ltv_mpc.control.node import ControllerNode
from ltv_mpc.messages import (
    Applied,
    ClockStep,
    ControllerStatus,
    FenceInForce,
    FenceReport,
    Health,
    Message,
    Plan,
    RunEvent,
)
from services.runtime.console import Level, Tell, tenfold
from services.runtime.process_time import step_text

LEVELS = {Health.NOMINAL: Level.INFO, Health.DEGRADED: Level.WARNING}
"""Level of a health; all others are errors."""


NO_FENCE = FenceReport(clearance_m=None)

WARNED_S = (300.0, 60.0, 20.0)
"""Times until the hull is in a zone below which this is reported, once each (s)."""

FORGOTTEN = 1.5
"""Share of such a time above which it may be reported again: the time of a drift is not steady."""


class FenceChanges:
    """Detector of what changes beside the hull from one plan to the next."""

    def __init__(self) -> None:
        self._before = NO_FENCE
        self._zones: tuple[tuple[object, ...], ...] = ()
        self._warned_s = math.inf  # of WARNED_S, the last one that was reported

    def update(self, fence: FenceReport | None) -> list[tuple[Level, str]]:
        """Take in the fence of the next plan, None without one; return what is to be reported."""
        before, after = self._before, fence or NO_FENCE
        self._before = after
        found = [*_entered_or_left("zone", Level.ERROR, before.inside, after.inside)]
        found += _entered_or_left("margin", Level.WARNING, before.in_margin, after.in_margin)
        if bool(after.exceeded) != bool(before.exceeded):
            lacks = f"the plan lacks more than 1 cm of a required clearance at {after.exceeded} of its points"
            again = (Level.INFO, "the plan keeps the required clearances again")
            found.append((Level.WARNING, lacks) if after.exceeded else again)
        if after.no_way != before.no_way:
            text = "no way round the zones leads to the target" if after.no_way else "a way to the target is found"
            found.append((Level.WARNING if after.no_way else Level.INFO, text))
        if after.skipped_m > 0.0 and after.skipped_m != before.skipped_m:
            text = f"the reference lies in a zone or its margin: {after.skipped_m:.1f} m are left out"
            found.append((Level.WARNING, text))
        time_s = math.inf if after.time_to_zone_ns is None else after.time_to_zone_ns * 1e-9
        if self._is_new(time_s):
            found.append((Level.WARNING, f"the hull will be in a zone or obstacle in {time_s:.0f} s"))
        why = "too old, or ahead of the clock of the estimates"
        return found + [(Level.WARNING, f"a report of obstacle {number} is dropped: {why}") for number in after.dropped]

    def in_force(self, fence: FenceInForce) -> list[tuple[Level, str]]:
        """Take in the fence that the controller keeps; return what is to be reported if its zones are others."""
        zones = tuple((zone.label, zone.radius_m, zone.margin_m, zone.vertices_m.tobytes()) for zone in fence.zones)
        before, self._zones = self._zones, zones
        if zones == before:
            return []
        if not zones:
            return [(Level.INFO, "no fence in force")]
        keep_in = sum(zone.keep_in for zone in fence.zones)
        return [(Level.INFO, f"fence in force: {keep_in} keep-in and {len(zones) - keep_in} keep-out zones")]

    def _is_new(self, time_s: float) -> bool:
        """Return True if a time to a zone is below a time of WARNED_S that has not been reported."""
        near = min((bound for bound in WARNED_S if time_s <= FORGOTTEN * bound), default=math.inf)
        self._warned_s = max(self._warned_s, near)
        below = min((bound for bound in WARNED_S if time_s < bound), default=math.inf)
        if below < self._warned_s:
            self._warned_s = below
            return True
        return False


def _entered_or_left(
    what: str, entered: Level, before: tuple[str, ...], after: tuple[str, ...]
) -> Iterator[tuple[Level, str]]:
    """Yield the labels that are new and those that are gone."""
    for label in after:
        if label not in before:
            yield entered, f"{what} entered: {label}"
    for label in before:
        if label not in after:
            yield Level.INFO, f"{what} left: {label}"


class ControllerChanges:
    """Detector of the changes, from the messages of one controller process."""

    def __init__(self, tell: Tell) -> None:
        self._tell = tell
        self._states: dict[str, object] = {}  # fields of the newest, by kind
        self._fence = FenceChanges()
        self._arrived = True  # a controller that continues may have arrived before
        self._reported_at: dict[str, int] = {}  # counts that were reported last, by their text
        self._reported: Mapping[str, int] | None = None  # counts in the newest report of the actuators
        self._since_start: dict[str, int] = {}  # what these counts have grown by

    def on_message(self, message: Message) -> list[RunEvent]:
        """Take in a plan of the controller, its fence, or an accepted input.

        Return what has changed of the fence, and an arrival, as events.
        """
        match message:
            case Plan():
                self._health_and_authority(message, message.cycle_t_ns)
                changes = [("fence", *change) for change in self._fence.update(message.fence)]
                if message.arrived and not self._arrived:
                    changes.append(("arrived", Level.INFO, "arrived at the end of the reference"))
                self._arrived = message.arrived
                return self._events(message.cycle_t_ns, changes)
            case FenceInForce():
                return self._events(message.t_ns, [("fence", *change) for change in self._fence.in_force(message)])
            case Applied():
                self._actuators(message)
            case ClockStep():
                fields: dict[str, str | int] = {"input": message.input, "step_ns": message.step_ns}
                self._tell(Level.WARNING, "clock", step_text(message), t_ns=message.t_ns, fields=fields)
            case _:
                pass
        return []

    def on_status(self, status: ControllerStatus) -> None:
        """Take in the controller's status, which also exists while there are no plans."""
        self._health_and_authority(status, status.t_ns)
        if status.source:
            source, epoch = status.source, status.source_epoch
            text = f"source of the estimates: {source}, epoch {epoch}"
            self._state(status.t_ns, "source", Level.INFO, text, source=source, epoch=epoch)
        for reason, count in status.rejected.items():
            self._count(status.t_ns, "rejected", f"rejected: {reason}", count, reason=reason)

    def _health_and_authority(self, message: Plan | ControllerStatus, t_ns: int) -> None:
        health, why, authority = message.health.value, message.health_why, message.authority.value
        text = f"health: {health} ({why})" if why else f"health: {health}"
        self._state(t_ns, "health", LEVELS.get(message.health, Level.ERROR), text, health=health, why=why)
        self._state(t_ns, "authority", Level.INFO, f"authority: {authority}", authority=authority)

    def _actuators(self, report: Applied) -> None:
        """Take in the counts of the actuators, which may be older than this process."""
        counts = {
            "plans rejected by the actuators": report.plans_rejected,
            "plans late at the actuators": report.plans_late,
        }
        before, self._reported = self._reported or counts, counts
        for text, count in counts.items():
            self._since_start[text] = self._since_start.get(text, 0) + max(0, count - before[text])
            self._count(report.t_ns, "plans", text, self._since_start[text])

    def _events(self, t_ns: int, changes: Sequence[tuple[str, Level, str]]) -> list[RunEvent]:
        for kind, level, text in changes:
            self._tell(level, kind, text, t_ns=t_ns, fields={})
        return [RunEvent(t_ns=t_ns, node=ControllerNode.name, kind=kind, text=text) for kind, _, text in changes]

    def _state(self, t_ns: int, kind: str, level: Level, text: str, **fields: str | int) -> None:
        """Report a state of this kind if its fields are new."""
        if self._states.get(kind) != fields:
            self._states[kind] = fields
            self._tell(level, kind, text, t_ns=t_ns, fields=fields)

    def _count(self, t_ns: int, kind: str, text: str, count: int, **fields: str | int) -> None:
        """Report a count if it has reached a power of ten since its last report."""
        if tenfold(count) > tenfold(self._reported_at.get(text, 0)):
            self._reported_at[text] = count
            said = text if count == 1 else f"{text}: {count} so far"
            self._tell(Level.WARNING, kind, said, t_ns=t_ns, fields={**fields, "count": count})
