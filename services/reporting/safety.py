"""Answer of a recorded run to "Is it safe?": health, command authority, plans, filter, fence and processes."""

from __future__ import annotations

import enum
from collections import Counter
from collections.abc import Mapping

import msgspec

from ltv_mpc.errors import with_reason
from ltv_mpc.messages import FilterStatus, Health, LocalisationReport, Message, NodeStatus, Plan
from services.supervisor.screen import in_order

SELDOM = 0.01
"""Largest share of cycles or reports that may be other than nominal in a run that was nominal at its end."""


class Mood(enum.StrEnum):
    """Assessment of a fact, which is the class of its text in a page."""

    NEUTRAL = ""
    GOOD = "good"
    BAD = "bad"


class Fact(msgspec.Struct, frozen=True, kw_only=True):
    """One fact about the whole run, under the name that the live page gives to its newest value."""

    name: str
    text: str
    mood: Mood = Mood.NEUTRAL


class ProcessFigures(msgspec.Struct, frozen=True, kw_only=True):
    """Last state of a process and its counts, over all of its starts."""

    name: str
    state: str
    starts: int
    step_us: float | None  # mean
    lost: int  # messages dropped or rejected


class _States(Counter[str]):
    """Number of times that each state was seen, and the newest one."""

    newest = ""

    def add(self, state: str) -> None:
        """Count a state."""
        self[state] += 1
        self.newest = state


class RunSafety:
    """Counter of what the messages of a run say about its safety. Give it every plan, filter report and status."""

    def __init__(self) -> None:
        self._health = _States()  # of the cycles
        self._authority: Counter[str] = Counter()
        self._origin: Counter[str] = Counter()
        self._filter = _States()  # of the reports
        self._nearest: tuple[float, str] | None = None  # least planned clearance (m), and the zone
        self._entered = 0  # cycles that began in a zone or margin
        self._lacking = 0  # plans that lack a required clearance
        self._statuses: dict[str, dict[int, NodeStatus]] = {}  # the newest by process and epoch
        self._wall_us: dict[str, float] = {}  # sum over the steps of a process

    def add(self, message: Message, epoch: int) -> None:
        """Count a message; ``epoch`` is the one of its sender."""
        match message:
            case Plan():
                self._health.add(with_reason(message.health.value, message.health_why))
                self._authority[message.authority.value] += 1
                self._origin[message.origin.value] += 1
                self._add_fence(message)
            case LocalisationReport():
                self._filter.add(with_reason(message.status.value, message.why))
            case NodeStatus():
                self._add_status(message, epoch)

    def facts(self) -> list[Fact]:
        """Return what is known, in the order of the live page."""
        facts = [
            _consistency("health", self._health, Health.NOMINAL.value, "cycles"),
            Fact(name="command authority", text=_shares(self._authority)),
            Fact(name="plan", text=_shares(self._origin)),
            _consistency("filter", self._filter, FilterStatus.NOMINAL.value, "reports"),
        ]
        if self._nearest is not None:
            clearance_m, zone = self._nearest
            text = f"plans keep {clearance_m:.2f} m or more from {zone}"
            if self._entered:
                text += f"; the hull was in a zone or its margin in {self._entered} cycles"
            if self._lacking:
                text += f"; {self._lacking} plans lack more than 1 cm of a required clearance"
            facts.append(Fact(name="fence", text=text, mood=Mood.BAD if self._entered or self._lacking else Mood.GOOD))
        return [fact for fact in facts if fact.text]

    def processes(self) -> list[ProcessFigures]:
        """Return the figures of each process that has published its status, in the order of the data."""
        return [
            ProcessFigures(
                name=name,
                state=process_state(list(epochs.values())[-1]),
                starts=len(epochs),
                step_us=self._wall_us[name] / steps if (steps := sum(one.steps for one in epochs.values())) else None,
                lost=sum(one.dropped + one.rejected for one in epochs.values()),
            )
            for name, epochs in in_order(self._statuses)
        ]

    def _add_fence(self, plan: Plan) -> None:
        if plan.fence is None or plan.fence.clearance_m is None:
            return
        self._entered += bool(plan.fence.inside or plan.fence.in_margin)
        self._lacking += plan.fence.exceeded > 0
        planned = plan.fence.clearance_m, plan.fence.nearest
        self._nearest = planned if self._nearest is None else min(self._nearest, planned)

    def _add_status(self, status: NodeStatus, epoch: int) -> None:
        epochs = self._statuses.setdefault(status.node, {})
        before = epochs[epoch].steps if epoch in epochs else 0
        wall_us = status.step_us * max(status.steps - before, 0)
        self._wall_us[status.node] = self._wall_us.get(status.node, 0.0) + wall_us
        epochs[epoch] = status


def process_state(status: NodeStatus) -> str:
    """Return the state of a process in words."""
    if status.finished:
        return "finished"
    return f"waits for {status.waiting_for}" if status.waiting_for else "running"


def _shares(counts: Mapping[str, int]) -> str:
    """Return the values with the number of cycles of each; of a single value only the value."""
    if len(counts) == 1:
        return f"{next(iter(counts))} in all cycles"
    return ", ".join(f"{count} {value}" for value, count in counts.items())


def _consistency(name: str, states: _States, nominal: str, unit: str) -> Fact:
    """Return in how many cycles or reports a state was nominal, and what it was most often otherwise.

    It is bad if it was not nominal at the end or in more than ``SELDOM`` of all: a start may wait for its inputs.
    """
    total, good = states.total(), states[nominal]
    if not total:
        return Fact(name=name, text="")
    if good == total:
        return Fact(name=name, text=f"{nominal} in all {total} {unit}", mood=Mood.GOOD)
    most_frequent = max((state for state in states if state != nominal), key=states.__getitem__)
    bad = states.newest != nominal or total - good > SELDOM * total
    text = f"{nominal} in {good} of {total} {unit}, otherwise most often {most_frequent}"
    return Fact(name=name, text=text, mood=Mood.BAD if bad else Mood.NEUTRAL)
