"""Event marks on the time axis: the events of the run, and changes of authority, health, plan origin and filter."""

from __future__ import annotations

from collections.abc import Callable

import msgspec

from ltv_mpc.errors import with_reason
from ltv_mpc.messages import (
    Acknowledgement,
    Command,
    FilterStatus,
    Health,
    LocalisationReport,
    Message,
    NodeStatus,
    Plan,
    RunEvent,
    Truth,
)

MAX_MARKS = 200
"""Number of marks that are kept; a plot with more is unreadable. Later ones are only counted."""


class Mark(msgspec.Struct, frozen=True, kw_only=True):
    """Event on the time axis: vehicle time, node and text."""

    t_s: float
    node: str
    text: str


class Marks:
    """Collector of event marks, in the order of arrival; ``omitted`` counts those beyond ``MAX_MARKS``."""

    def __init__(self, seconds: Callable[[int], float] = lambda t_ns: t_ns / 1e9) -> None:
        """``seconds`` converts a vehicle time (ns) to the time axis."""
        self._seconds = seconds
        self.marks: list[Mark] = []
        self.omitted = 0
        self._states = {"health": Health.NOMINAL.value, "filter": FilterStatus.NOMINAL.value}
        self.since_s: dict[str, float] = {}
        """Time at which health, authority and others took their newest value."""
        self._epochs: dict[str, int] = {}
        self._commands: dict[int, tuple[Command, int]] = {}  # with the epoch of the sender, by identifier
        self._simulator: int | None = None  # epoch of the simulated vehicle
        self._newest_ns = 0

    def add(self, message: Message, epoch: int) -> None:
        """Add the marks that follow from a message; ``epoch`` is the one of its sender."""
        match message:
            case RunEvent():
                self._append(message.t_ns, message.node, message.text)
            case Plan():
                self._add_plan(message)
            case LocalisationReport():
                self._add_state(message.t_ns, "estimator", "filter", message.status.value, message.why)
            case Command():
                self._commands[message.command_id] = message, epoch
            case Truth():
                self._simulator = epoch
            case Acknowledgement():
                self._add_acknowledgement(message)
            case NodeStatus():
                if self._epochs.setdefault(message.node, epoch) != epoch:
                    self._epochs[message.node] = epoch
                    # its first status may be sent before it knows the vehicle time
                    self._append(max(message.t_ns, self._newest_ns), message.node, "restarted")

    def _add_plan(self, plan: Plan) -> None:
        self._newest_ns = plan.cycle_t_ns
        health = with_reason(plan.health.value, plan.health_why)
        self._add_state(plan.cycle_t_ns, "controller", "command authority", plan.authority.value)
        self._add_state(plan.cycle_t_ns, "controller", "health", health)
        self._add_state(plan.cycle_t_ns, "controller", "plan origin", plan.origin.value, plan.why)

    def _add_state(self, t_ns: int, node: str, what: str, state: str, why: str = "") -> None:
        """Add a mark if the state has changed; a first state is one only of health or filter that is not nominal."""
        if self._states.get(what) != state:
            if what in self._states:
                self._append(t_ns, node, with_reason(f"{what}: {state}", why))
            self._states[what], self.since_s[what] = state, self._seconds(t_ns)

    def _add_acknowledgement(self, answer: Acknowledgement) -> None:
        command, epoch = self._commands.pop(answer.command_id, (None, None))
        asked = "a command" if command is None else command.action.value
        # A simulated vehicle arms by force before the first estimate: what it skips is no event of the run.
        simulated = epoch is not None and epoch == self._simulator
        why = answer.why if not answer.accepted else "" if simulated else "; ".join(answer.warnings)
        text = with_reason(f"{asked} {'accepted' if answer.accepted else 'rejected'}", why)
        self._append(answer.t_ns, "controller", text)

    def _append(self, t_ns: int, node: str, text: str) -> None:
        if len(self.marks) < MAX_MARKS:
            self.marks.append(Mark(t_s=round(self._seconds(t_ns), 3), node=node, text=text))
        else:
            self.omitted += 1
